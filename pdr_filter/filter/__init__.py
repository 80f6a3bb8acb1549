"""Events in, rows of a track out: step lengths, motion, the IMM, the weightings, fixes."""
