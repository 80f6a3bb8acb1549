"""Sensor processing: conditioning, attitude, gyroscope bias, steps, contexts and walking headings."""
