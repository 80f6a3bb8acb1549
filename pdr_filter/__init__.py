"""Pedestrian dead reckoning: a phone's inertial samples in, a track with honest uncertainty out.

The public names are those of `__init__.pyi`, and stand only there. Each is loaded when it is first used, so that
importing the package costs nothing that is not needed.
"""

import lazy_loader

from pdr_filter.version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
