"""Command line `pdr-filter`."""

from pdr_filter.cli.app import main

__all__ = ["main"]
