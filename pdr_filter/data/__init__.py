"""Data: files of recordings (`io`), and public recordings (`datasets`)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submodules=["datasets"])
