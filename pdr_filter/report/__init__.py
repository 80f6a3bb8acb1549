"""What people see of a track: plots, HTML reports, and where not to trust it."""
