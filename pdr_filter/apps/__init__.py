"""Applications of the framework: floor plans, reports, many recordings, maps of buildings, servers and the command."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submodules=["batch"])
