"""Pedestrian dead reckoning: estimate a track with its uncertainty from the inertial samples of a phone.

`__init__.pyi` lists the public names. Each name is loaded at its first use, so that importing the package is fast.
"""

import lazy_loader

from pdr_filter.version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
