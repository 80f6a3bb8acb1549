"""Files that are opened, bounded and written: archives, the project's own format, tracks."""
