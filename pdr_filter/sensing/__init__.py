"""Samples in, events out: uniform samples, attitude, bias, steps, contexts and walking headings."""
