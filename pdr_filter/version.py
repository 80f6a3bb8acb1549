"""The version of the package: the build reads it from here, and `pdr_filter.__version__` is it."""

__version__ = "0.3.0"
