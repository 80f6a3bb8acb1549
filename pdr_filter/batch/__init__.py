"""Many recordings, on several processes or a Dask cluster.

The public names are those of `__init__.pyi`. Each is loaded when it is first used: the live server needs the worker
processes of this package and not the filter.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
