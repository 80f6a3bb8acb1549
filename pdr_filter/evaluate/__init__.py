"""Evaluation measures for step detectors, classifiers, distances, tracks and covariances.

Most functions take arrays. `comparison` makes tables for several tracks of one recording, and `study` for several
recordings. Only `runs` runs the filter.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
