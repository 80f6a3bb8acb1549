"""Plots and HTML reports of tracks."""

import lazy_loader

# loaded lazily, because only figures need matplotlib
__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submodules=["plot"])
