"""Batch processing of many recordings, on several processes or a Dask cluster.

`__init__.pyi` lists the public names. Each name is loaded at its first use, because the live server needs the worker
processes of this package but not the filter.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
