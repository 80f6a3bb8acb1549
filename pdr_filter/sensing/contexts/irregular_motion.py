"""The probability that the phone's motion moves nobody: it is taken out, typed on, turned or put away.

The irregular class of Susi, Renaudin and Lachapelle 2013, "Motion mode recognition and step detection algorithms for
mobile phone users" (Sensors 13). The contexts of `pdr_filter.values.contexts.CONTEXTS` have no such class, and a
classifier of them has to call a hand that types one of them. Here it is two classes and a logistic gate: irregular
motion against gait (walking, stairs, running, however the phone is carried). A window in which the phone lies or hangs
still is neither and gets zero.

p = sigmoid(b + sum_i w_i clip((x_i - m_i) / s_i, -4, 4)), x the features of one 2 s window of
`pdr_filter.sensing.features.invariant`. In words: a phone that is handled turns far for how little it bounces, and
what it does does not repeat from step to step.

Where the numbers come from:

- Irregular: what six people (1 to 6) do with the phone more than 1 s before or after the walk, in the recordings of
  A. Brajdic and R. Harle, "Walk detection and step counting on unconstrained smartphones", UbiComp 2013,
  doi:10.1145/2493432.2493449. Only these weights are printed, nothing else of that data is here.
- Gait: half of it the walks of these six, half MotionSense, Tyrex, humolire, ms_indoor and, without gyroscope, oxford,
  every context and carrying mode of a set with the same mass; windows slower than 0.5 m/s (Tyrex, by motion capture)
  are left out. Still windows are left out of both classes.
- m and s are mean and standard deviation of both classes, irregular windows having the mass `TRAINING_PRIOR`, rounded;
  w and b are the logistic regression on the rounded ones (mean log loss + 0.0005 sum_i w_i^2), rounded. Which eight
  features was decided by log loss on people and sets left out, without people 7 to 13.

On the seven other people of the same data (7 to 13) it finds 0.89 of irregular
windows at 1 % false alarms with gyroscope (90 % interval 0.78 to 0.95) and 0.80 (0.69 to 0.94) without; at p > 0.5 it
finds 0.93 and 0.91 at 2.4 % and 3.6 % false alarms.

Limits:

- One protocol: people who handle a phone before and after a walk. Handling it while walking is not in the data.
- Slow shuffling counts as irregular: below 0.5 m/s 45 % of the moving windows with gyroscope, 67 % without (Tyrex).
- A phone that swings in the hand is hard to recognise without gyroscope: false alarms 24 % in Tyrex, 38 % with Tyrex
  left out of the fit (oxford: 4 % both times); with gyroscope 1 %.
- Fidgeting while sitting or standing counts as irregular: 99 % of the moving windows of MotionSense's sitting and
  standing.
- The features change with how the attitude was found, and each gate is for its own: where the attitude had a gyroscope
  the accelerometer gate finds 0.64 instead of 0.80 at 1 % false alarms.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from pdr_filter.values import FloatArray, IntArray, check_numbers, read_only

# Share of irregular among moving windows in the fit: divide it out where another prior holds. Among the moving windows
# of people 7 to 13 it is 0.31.
TRAINING_PRIOR = 0.30
# Standard deviations at which a feature is cut, in the fit too: no single feature can outvote the others.
_LIMIT = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class IrregularGate:
    """A logistic gate with a rule for stillness."""

    feature_names: tuple[str, ...]  # (F,) of `pdr_filter.sensing.features.invariant.NAMES`
    mean: FloatArray  # (F,) m
    scale: FloatArray  # (F,) s
    weight: FloatArray  # (F,) w
    intercept: float  # b
    still_names: tuple[str, ...]  # (S,) features that are all low where the phone is still
    still_below: FloatArray  # (S,) how low

    def __post_init__(self) -> None:
        check_numbers(self, signed=("intercept",))
        for name in ("mean", "scale", "weight", "still_below"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def names(self) -> tuple[str, ...]:
        """Features that `prob` takes, in its order: those of the logit, then those of the stillness rule."""
        return (*self.feature_names, *self.still_names)

    def prob(self, features: FloatArray) -> FloatArray:
        """Probabilities (...) of irregular motion from the features of windows, (..., F + S) in the order of `names`.

        Zero for a still window. Raises ValueError for NaN, naming the feature.
        """
        if features.shape[-1] != len(self.names):
            raise ValueError(f"features must be (..., {len(self.names)}) in the order of names, got {features.shape}")
        if np.isnan(features).any():
            bad = self.names[int(np.argwhere(np.isnan(features))[0, -1])]
            raise ValueError(f"feature {bad} is NaN: leave such windows out")
        of_logit, of_stillness = features[..., : len(self.mean)], features[..., len(self.mean) :]
        z = np.minimum(np.maximum((of_logit - self.mean) / self.scale, -_LIMIT), _LIMIT)
        # One addition after the other: the order of `np.sum`, and so the last bit, depends on the number of windows.
        log_odds = self.intercept + sum(np.moveaxis(self.weight * z, -1, 0))
        is_still = (of_stillness < self.still_below).all(axis=-1)
        return np.where(is_still, 0.0, 1.0 / (1.0 + np.exp(-log_odds)))


def irregular_prob(names: tuple[str, ...], features: FloatArray, has_gyroscope: bool) -> FloatArray:
    """Probabilities (...) of irregular motion of windows with features (..., F): the gate depends on the gyroscope."""
    gate = GATE if has_gyroscope else GATE_ACCELEROMETER
    return gate.prob(features[..., _columns(names, has_gyroscope)])


@cache
def _columns(names: tuple[str, ...], has_gyroscope: bool) -> IntArray:
    """Where the features of a gate are."""
    needed = (GATE if has_gyroscope else GATE_ACCELEROMETER).names
    missing = sorted(set(needed) - set(names))
    if missing:
        raise ValueError(f"the gate needs {', '.join(missing)}: take windows of the features ATTITUDE_FREE")
    return np.array([names.index(n) for n in needed])


def _gate(rows: dict[str, tuple[float, float, float]], intercept: float, still: dict[str, float]) -> IrregularGate:
    mean, scale, weight = np.array(list(rows.values())).T
    return IrregularGate(tuple(rows), mean, scale, weight, intercept, tuple(still), np.array(list(still.values())))


# Feature: mean, scale, weight; fitted as in the module's docstring.
#
# Stillness: a vertical standard deviation below exp(-1) - 0.02 = 0.35 m/s2, and a rate about the main axis of rotation
# below exp(-1.6) - 0.005 = 0.20 rad/s or, without gyroscope, a horizontal standard deviation below 0.35 m/s2 as well
# (the floors are those of `invariant`). It takes none of the 2948 windows of walks of all thirteen people, 7 of 11 560
# of gait in the other sets (3 of 13 889 without gyroscope), and 93 % (88 %) of MotionSense's sitting and standing.
GATE = _gate(
    {
        "log_swing": (-2.135, 0.833, +3.144),
        "log_std_vertical": (0.660, 0.940, -4.182),
        "log_band_forward_0.4_1.2_hz": (-0.895, 1.046, -1.381),
        "log_band_lateral_0.4_1.2_hz": (-1.368, 0.904, -0.862),
        "step_regularity": (0.563, 0.277, -1.003),
        "skewness_horizontal": (1.188, 0.821, +0.798),
        "main_rate_skewness": (0.611, 0.724, +0.503),
        "swing_repeats_after_0.2_s": (-0.005, 0.239, -0.885),
    },
    intercept=-2.533,
    still={"log_std_vertical": -1.0, "log_std_main_rate": -1.6},
)
GATE_ACCELEROMETER = _gate(
    {
        "log_band_vertical_0.4_1.2_hz": (-1.135, 1.053, +0.723),
        "log_band_vertical_1.2_1.7_hz": (-0.727, 1.143, -2.310),
        "log_band_vertical_1.7_2.2_hz": (-0.657, 1.290, -1.133),
        "log_band_vertical_4.7_7_hz": (-0.676, 1.013, -1.855),
        "step_regularity": (0.575, 0.275, -1.384),
        "step_lag_s": (0.628, 0.212, -0.786),
        "skewness_vertical": (0.346, 0.813, -0.531),
        "log_std_forward": (0.538, 0.727, +1.383),
    },
    intercept=-2.185,
    still={"log_std_vertical": -1.0, "log_std_forward": -1.0},
)
