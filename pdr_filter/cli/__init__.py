"""The command `pdr-filter`."""
