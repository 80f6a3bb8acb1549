"""Figures of tracks and calibrations. Functions draw into given axes or into a new figure, and return the axes.

`save` writes the figure of the axes to a file. PDF and SVG files are vector graphics with embedded fonts. Figures
belong to no window and to no pyplot state, so that they need not be closed.
"""
# ruff: noqa: E402 - the next call must come before the modules, which import matplotlib

from pdr_filter.values.optional_packages import load_optional

load_optional("matplotlib")

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
