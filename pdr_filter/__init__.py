"""Pedestrian dead reckoning: a phone's inertial samples in, a track with honest uncertainty out.

The public names are those of `__init__.pyi`, and stand only there. Each is loaded when it is first used, so that
importing the package costs nothing that is not needed.
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
    """Import modules by their names in version 0.1, with a DeprecationWarning. The last finder that Python asks."""

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Return the specification of a module that has moved; None for any other name."""
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
        """Return former and present names of modules, without the package."""
        lines = Path(__file__).with_name("former_modules.txt").read_text(encoding="utf-8").splitlines()
        return dict(line.split() for line in lines)

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return a module whose names are looked up in the present one."""
        present = importlib.import_module(spec.loader_state)
        module = ModuleType(spec.name, present.__doc__)
        module.__dict__.update({key: value for key, value in vars(present).items() if not key.startswith("__")})
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Nothing is left to execute."""


sys.meta_path.append(_FormerModules())
