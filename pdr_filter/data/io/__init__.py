"""Reading recordings, the only place that converts units, axes and clocks; describing them; writing tracks."""
