"""Command line `pdr-filter`."""

from pdr_filter.apps.cli.app import main

__all__ = ["main"]
