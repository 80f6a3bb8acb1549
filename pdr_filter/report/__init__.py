"""What people see of a track: plots, HTML reports, and where not to trust it."""

import lazy_loader

# figures need matplotlib, which pages and palettes do not
__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submodules=["plot"])
