"""Pedestrian dead reckoning: estimate a track with its uncertainty from the inertial samples of a phone.

`__init__.pyi` lists the public names. Each name is loaded at its first use, so that importing the package is fast.
"""

import importlib.util
import sys
import warnings
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

import lazy_loader

from pdr_filter.version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


class _FormerModules(MetaPathFinder, Loader):
    """Import modules by their names in version 0.1, with a DeprecationWarning.

    This finder is the last in `sys.meta_path`, so that existing modules have priority.
    """

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Return the specification of a renamed module, or None for any other name."""
        package, _, name = fullname.partition(".")
        if package != __name__ or name not in self.moved():
            return None
        new = f"{__name__}.{self.moved()[name]}"
        warnings.warn(f"{fullname} is now {new}", DeprecationWarning, stacklevel=2)
        spec = importlib.util.spec_from_loader(fullname, self, is_package=True)
        if spec is not None:
            spec.loader_state = new
        return spec

    @staticmethod
    def moved() -> dict[str, str]:
        """Return the present names of renamed modules by their former names, both without the package."""
        lines = Path(__file__).with_name("former_modules.txt").read_text(encoding="utf-8").splitlines()
        return dict(line.split() for line in lines)

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return a module with the contents of the renamed module."""
        present = importlib.import_module(spec.loader_state)
        module = ModuleType(spec.name, present.__doc__)
        module.__dict__.update({key: value for key, value in vars(present).items() if not key.startswith("__")})
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Do nothing, because `create_module` returns a complete module."""


sys.meta_path.append(_FormerModules())
