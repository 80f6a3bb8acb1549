"""Features by which windows are classified: their protocol, features of a function, and several sets as one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from pdr_filter.values.arrays import FloatArray


class FeatureSet(Protocol):
    """Features of windows; a frozen dataclass of this package, if it is to be saved with a filter."""

    @property
    def name(self) -> str:
        """Name on model cards."""
        ...

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the features."""
        ...

    @property
    def low_pass_hz(self) -> float | None:
        """Cutoff of the low-passed |f|; None if no feature is of it: then it is zeros."""
        ...

    def describe(self, windows: FloatArray, rate_hz: float) -> FloatArray:
        """Features (W, F) of the signals of windows (W, N_SIGNALS, N); of a missing sensor they are zeros."""
        ...


#: Names of the signals of a window, in the order of its rows. Functions get the signals by these names.
WINDOW_SIGNALS: tuple[str, ...] = (
    "force_mps2",  # magnitude of the specific force
    "low_passed_force_mps2",  # zeros unless the feature set has `low_pass_hz`
    "rate_radps",  # magnitude of the angular rate
    "magnetic_field_ut",  # magnitude
    "vertical_mps2",  # specific force along up, less gravity
    "east_mps2",  # horizontal specific force in the frame of the attitude, whose heading is arbitrary
    "north_mps2",
    *(f"rate_{axis}_radps" for axis in "xyz"),  # sensor frame, as are all others
    *(f"up_{axis}" for axis in "xyz"),  # unit vector
    *(f"force_{axis}_mps2" for axis in "xyz"),
)
FeatureFunction = Callable[[Mapping[str, FloatArray]], Mapping[str, float]]


@dataclass(frozen=True)
class FunctionFeatures:
    """Features that a function computes, window by window.

    The function gets the signals of a window by their names in `WINDOW_SIGNALS`, each (N,) at 100 Hz, and returns the
    features by their names. Signals of a missing sensor are zeros.
    """

    function: FeatureFunction
    names: tuple[str, ...]
    low_pass_hz: None = None

    @classmethod
    def of(cls, function: FeatureFunction) -> FunctionFeatures:
        """Return the features of a function, which is called once, on noise, for their names."""
        noise = np.random.default_rng(0).normal(size=(len(WINDOW_SIGNALS), 200))
        found = function(dict(zip(WINDOW_SIGNALS, noise, strict=True)))
        if not (isinstance(found, Mapping) and found):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise ValueError(
                f"features must return a number for each name, such as {{'force_std': 0.3}}, got {found!r}: return a "
                "dict"
            )
        return cls(function, tuple(str(name) for name in found))

    @property
    def name(self) -> str:
        """Name of the function."""
        return getattr(self.function, "__name__", type(self.function).__name__)

    def describe(self, windows: FloatArray, rate_hz: float) -> FloatArray:
        """Features (W, F) of the signals of windows (W, N_WINDOW_SIGNALS, N)."""
        found = [self.function(dict(zip(WINDOW_SIGNALS, window, strict=True))) for window in windows]
        for each in found:
            if tuple(each) != self.names:
                raise ValueError(
                    f"features must return the same names for every window, got {tuple(each)} after {self.names}: "
                    "return a value for each name"
                )
        return np.array([[float(value) for value in each.values()] for each in found])


@dataclass(frozen=True)
class JoinedFeatures:
    """Features of several sets, one set after the other. ValueError if two have a feature of the same name."""

    sets: tuple[FeatureSet, ...]

    def __post_init__(self) -> None:
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        cutoffs_hz = {each.low_pass_hz for each in self.sets if each.low_pass_hz is not None}
        if twice:
            raise ValueError(
                f"features {twice[:5]} are in two of the sets {self.name}: give other names to one of them"
            )
        if len(cutoffs_hz) > 1:
            raise ValueError(f"low_pass_hz of feature sets used together must be one, got {sorted(cutoffs_hz)}")

    @property
    def name(self) -> str:
        """Names of the sets."""
        return " and ".join(each.name for each in self.sets)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the features."""
        return tuple(name for each in self.sets for name in each.names)

    @property
    def low_pass_hz(self) -> float | None:
        """Cutoff of the low-passed |f|, None if no set uses it."""
        return next((each.low_pass_hz for each in self.sets if each.low_pass_hz is not None), None)

    def describe(self, windows: FloatArray, rate_hz: float) -> FloatArray:
        """Features (W, F) of the signals of windows (W, N_WINDOW_SIGNALS, N)."""
        return np.concatenate([each.describe(windows, rate_hz) for each in self.sets], axis=1)


def feature_set_of(features: FeatureSet | FeatureFunction) -> FeatureSet:
    """Return the feature set, or that of a function; ValueError for anything else."""
    if hasattr(features, "describe") and hasattr(features, "names"):
        return features  # pyright: ignore[reportReturnType]
    if not callable(features):
        raise ValueError(
            f"features must be a feature set or a function of the signals of a window, got {features!r}: give a "
            "function that returns a dict of numbers"
        )
    return FunctionFeatures.of(features)
