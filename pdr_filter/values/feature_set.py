"""Features for the classification of windows: their protocol, features of a function, and joined sets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from pdr_filter.values.arrays import FloatArray


class FeatureSet(Protocol):
    """Protocol of the features of windows.

    To be saved with a filter, a feature set must be a frozen dataclass of this package.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.values.feature_set import WINDOW_SIGNALS
    >>> class MeanForce:
    ...     name, names, low_pass_hz = "mean force", ("mean_force",), None
    ...     def describe(self, windows, rate_hz):
    ...         return windows[:, :1].mean(axis=2)
    >>> MeanForce().describe(np.ones((3, len(WINDOW_SIGNALS), 200)), 100.0).shape
    (3, 1)
    """

    @property
    def name(self) -> str:
        """Name for model cards."""
        ...

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the F features."""
        ...

    @property
    def low_pass_hz(self) -> float | None:
        """Cutoff frequency in Hz of the low-passed magnitude of the specific force.

        None if no feature uses this signal, which is then zero.
        """
        ...

    def describe(self, windows: FloatArray, rate_hz: float) -> FloatArray:
        """Return the features of windows.

        Parameters
        ----------
        windows : (W, n_signals, N) array
            Signals of W windows in the order of `WINDOW_SIGNALS`. The signals of a missing sensor are zeros.
        rate_hz : float
            Sampling rate, Hz.

        Returns
        -------
        (W, F) array
            Features in the order of `names`.
        """
        ...


#: Names of the signals of a window, in the order of its rows. Functions get the signals by these names: magnitudes of
#: the specific force, low-passed specific force, angular rate and magnetic field; the specific force along up minus
#: gravity, and its horizontal components in a frame of arbitrary heading; angular rate, unit vector up and specific
#: force in the sensor frame. The signals of a missing sensor are zeros.
WINDOW_SIGNALS: tuple[str, ...] = (
    "force_mps2",  # magnitude of the specific force
    "low_passed_force_mps2",  # zeros unless the feature set has `low_pass_hz`
    "rate_radps",  # magnitude of the angular rate
    "magnetic_field_ut",  # magnitude
    "vertical_mps2",  # upward specific force, minus gravity
    "east_mps2",  # horizontal specific force in the frame of the attitude, whose heading is arbitrary
    "north_mps2",
    *(f"rate_{axis}_radps" for axis in "xyz"),  # sensor frame, like all following signals
    *(f"up_{axis}" for axis in "xyz"),  # unit vector
    *(f"force_{axis}_mps2" for axis in "xyz"),
)
FeatureFunction = Callable[[Mapping[str, FloatArray]], Mapping[str, float]]


@dataclass(frozen=True)
class FunctionFeatures:
    """Features computed by a function, window by window.

    The function gets the signals of a window, each (N,), in a dictionary by their names in `WINDOW_SIGNALS`, at the
    rate of the windows (100 Hz in the default recipe). It returns a dictionary of the features. Signals of a missing
    sensor are zeros.
    """

    function: FeatureFunction
    names: tuple[str, ...]
    low_pass_hz: None = None

    @classmethod
    def of(cls, function: FeatureFunction) -> FunctionFeatures:
        """Return the features of a function, which is called once, on noise, to get their names."""
        noise = np.random.default_rng(0).normal(size=(len(WINDOW_SIGNALS), 200))
        found = function(dict(zip(WINDOW_SIGNALS, noise, strict=True)))
        if not (isinstance(found, Mapping) and found):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise ValueError(
                f"features must return a dict of a number for each name, such as {{'force_std': 0.3}}, got {found!r}"
            )
        return cls(function, tuple(str(name) for name in found))

    @property
    def name(self) -> str:
        """Name of the function."""
        return getattr(self.function, "__name__", type(self.function).__name__)

    def describe(self, windows: FloatArray, rate_hz: float) -> FloatArray:
        """Return the features (W, F) of windows (W, R, N). ValueError if their names change."""
        found = [self.function(dict(zip(WINDOW_SIGNALS, window, strict=True))) for window in windows]
        for each in found:
            if tuple(each) != self.names:
                raise ValueError(
                    "features must return the same names in the same order for every window, got "
                    f"{tuple(each)} after {self.names}: return a value for each name"
                )
        return np.array([[float(value) for value in each.values()] for each in found])


@dataclass(frozen=True)
class JoinedFeatures:
    """Concatenation of several feature sets. ValueError if two sets have a feature of the same name."""

    sets: tuple[FeatureSet, ...]

    def __post_init__(self) -> None:
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        cutoffs_hz = {each.low_pass_hz for each in self.sets if each.low_pass_hz is not None}
        if twice:
            raise ValueError(
                f"features of joined sets must have different names, got {twice[:5]} twice in {self.name}: rename them "
                "in one of the sets"
            )
        if len(cutoffs_hz) > 1:
            raise ValueError(f"joined feature sets must have the same low_pass_hz, got {sorted(cutoffs_hz)}")

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
        """Cutoff frequency in Hz of the low-passed magnitude of the specific force, or None if no set uses it."""
        return next((each.low_pass_hz for each in self.sets if each.low_pass_hz is not None), None)

    def describe(self, windows: FloatArray, rate_hz: float) -> FloatArray:
        """Return the features (W, F) of windows with all `WINDOW_SIGNALS`, (W, R, N), at `rate_hz`."""
        return np.concatenate([each.describe(windows, rate_hz) for each in self.sets], axis=1)


def feature_set_of(features: FeatureSet | FeatureFunction) -> FeatureSet:
    """Return a feature set unchanged, or the features of a function. ValueError for anything else."""
    if hasattr(features, "describe") and hasattr(features, "names"):
        return features  # pyright: ignore[reportReturnType]
    if not callable(features):
        raise ValueError(
            f"features must be a feature set or a function of the signals of a window, got {features!r}: give a "
            "function that returns a dict of numbers"
        )
    return FunctionFeatures.of(features)
