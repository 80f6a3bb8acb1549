"""Updates by fixes: gating, rotation of the frame of the fixes, relocation, ranges, and GNSS locations."""
