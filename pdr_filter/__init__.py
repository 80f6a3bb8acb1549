"""Pedestrian dead reckoning: estimate a track with its uncertainty from the inertial samples of a phone.

`__init__.pyi` lists the public names. Each name is loaded at its first use, so that importing the package is fast.
"""

import importlib
import os
import sys
import warnings
from importlib.machinery import ModuleSpec
from types import ModuleType

import lazy_loader

from pdr_filter.version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


class _FormerModules:
    """Finder and loader of modules by their names in version 0.1, with a DeprecationWarning.

    This finder is the last in `sys.meta_path`, so that existing modules have priority. It has no base class, because
    importing `importlib.abc` and `pathlib` would take longer than importing the package.
    """

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Return the specification of a renamed module, with a DeprecationWarning, or None for any other name."""
        package, _, name = fullname.partition(".")
        if package != __name__ or name not in self.moved():
            return None
        new = f"{__name__}.{self.moved()[name]}"
        warnings.warn(f"{fullname} is now {new}", DeprecationWarning, stacklevel=2)
        return ModuleSpec(fullname, self, is_package=True, loader_state=new)  # pyright: ignore[reportArgumentType]

    @staticmethod
    def moved() -> dict[str, str]:
        """Return the present names of renamed modules by their former names, both without the package."""
        path = os.path.join(os.path.dirname(__file__), "former_modules.txt")  # noqa: PTH118, PTH120
        with open(path, encoding="utf-8") as file:  # noqa: PTH123
            return dict(line.split() for line in file)

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return a module with the contents of the renamed module."""
        present = importlib.import_module(spec.loader_state)
        module = ModuleType(spec.name, present.__doc__)
        module.__dict__.update({key: value for key, value in vars(present).items() if not key.startswith("__")})
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Do nothing, because `create_module` returns a complete module."""


sys.meta_path.append(_FormerModules())
