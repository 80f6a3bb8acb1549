"""Height from barometer and steps, and the detection of floors."""
