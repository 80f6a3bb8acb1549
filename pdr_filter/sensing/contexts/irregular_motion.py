"""Probability of irregular motion: the phone is taken out, typed on, turned or put away while the person stands.

This is the irregular class of Susi, Renaudin and Lachapelle 2013, "Motion mode recognition and step detection
algorithms for mobile phone users" (Sensors 13). The contexts of `pdr_filter.values.contexts.CONTEXTS` have no such
class, so a context classifier must assign the motion of a typing hand to one of them. Here a logistic gate separates
irregular motion from gait (walking, stairs, running, with any carrying mode). A window in which the phone lies or hangs
still is neither, and gets probability zero.

p = sigmoid(b + sum_i w_i clip((x_i - m_i) / s_i, -4, 4)), where x are the features of one 2 s window of
`pdr_filter.sensing.features.invariant`. A handled phone rotates much relative to its bounce, and its motion does not
repeat from step to step.

Source of the numbers:

- Irregular motion: what six persons (1 to 6) do with the phone more than 1 s before or after the walk, in the
  recordings of A. Brajdic and R. Harle, "Walk detection and step counting on unconstrained smartphones", UbiComp 2013,
  doi:10.1145/2493432.2493449. Only the weights below are derived from these data; the data are not included.
- Gait: one half are the walks of these six persons. The other half are MotionSense, Tyrex, humolire, ms_indoor and,
  without gyroscope, oxford, with equal weight for each context and carrying mode of a data set. Windows slower than
  0.5 m/s (Tyrex, by motion capture) are excluded. Still windows are excluded from both classes.
- m and s are the rounded mean and standard deviation over both classes, where irregular windows have the total weight
  0.30. (Among the moving windows of persons 7 to 13 their share is 0.31. Divide the odds by those of 0.30 where another
  prior holds.) w and b are the rounded logistic regression on these (mean log loss + 0.0005 sum_i w_i^2). The eight
  features were selected by the log loss on held-out persons and data sets, without persons 7 to 13.

On the other seven persons of the same data (7 to 13), the gate with gyroscope finds 0.89 of the irregular windows at
1 % false alarms (90 % interval 0.78 to 0.95), and 0.80 (0.69 to 0.94) without gyroscope. At p > 0.5 it finds 0.93 and
0.91 at 2.4 % and 3.6 % false alarms.

Limits:

- One protocol: persons who handle a phone before and after a walk. Handling while walking is not in the data.
- Slow shuffling counts as irregular: below 0.5 m/s, 45 % of the moving windows with gyroscope and 67 % without (Tyrex).
- A phone that swings in the hand is hard to recognise without gyroscope: 24 % false alarms in Tyrex, 38 % with Tyrex
  held out (oxford: 4 % in both cases). With gyroscope there are 1 %.
- Fidgeting while sitting or standing counts as irregular: 99 % of the moving windows of sitting and standing in
  MotionSense.
- The features depend on how the attitude was estimated, so each gate is only for its own sensors. With an attitude from
  a gyroscope, the accelerometer gate finds 0.64 instead of 0.80 at 1 % false alarms.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from pdr_filter.values import FloatArray, IntArray, check_numbers, read_only

# Number of standard deviations at which features are clipped, also in the fit, so that no single feature dominates.
_LIMIT = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class IrregularGate:
    """Logistic model of irregular motion with a rule for still windows."""

    # Names of the F features of the logistic model, from `pdr_filter.sensing.features.invariant.NAMES`.
    feature_names: tuple[str, ...]
    mean: FloatArray  # (F,) means m of the features
    scale: FloatArray  # (F,) standard deviations s of the features
    weight: FloatArray  # (F,) weights w
    intercept: float  # intercept b
    still_names: tuple[str, ...]  # names of the S features that are all below their limits in a still window
    still_below: FloatArray  # (S,) limits of these features

    def __post_init__(self) -> None:
        check_numbers(self, signed=("intercept",))
        for name in ("mean", "scale", "weight", "still_below"):
            object.__setattr__(self, name, read_only(getattr(self, name), name))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the features that `prob` takes, first for the logistic model, then for the stillness rule."""
        return (*self.feature_names, *self.still_names)

    def prob(self, features: FloatArray) -> FloatArray:
        """Return the probabilities (...) of irregular motion for features (..., F + S) in the order of `names`.

        A still window has probability zero. Raises ValueError for a wrong number of features, and for NaN with the name
        of the feature.
        """
        if features.shape[-1] != len(self.names):
            raise ValueError(
                f"features must be (..., {len(self.names)}), got {features.shape}: select the columns that "
                "IrregularGate.names lists"
            )
        if np.isnan(features).any():
            bad = self.names[int(np.argwhere(np.isnan(features))[0, -1])]
            raise ValueError(f"feature {bad} is NaN: remove the windows with missing features first")
        logit_features, still_features = features[..., : len(self.mean)], features[..., len(self.mean) :]
        z = np.minimum(np.maximum((logit_features - self.mean) / self.scale, -_LIMIT), _LIMIT)
        # `accumulate` adds in a fixed order. The order of `np.sum`, and with it the last bit, depends on the number of
        # windows.
        log_odds = self.intercept + np.add.accumulate(self.weight * z, axis=-1)[..., -1]
        is_still = np.logical_and.reduce(still_features < self.still_below, axis=-1)
        return np.where(is_still, 0.0, 1.0 / (1.0 + np.exp(-log_odds)))


def irregular_prob(names: tuple[str, ...], features: FloatArray, has_gyroscope: bool) -> FloatArray:
    """Return the probabilities (...) of irregular motion for features (..., F) of windows with or without gyroscope.

    `names` are the names of the F features.
    """
    gate = GATE if has_gyroscope else GATE_ACCELEROMETER
    return gate.prob(features[..., _gate_columns(names, has_gyroscope)])


@cache
def _gate_columns(names: tuple[str, ...], has_gyroscope: bool) -> IntArray:
    """Return the positions of the features of a gate among all names. ValueError if features are missing."""
    needed = (GATE if has_gyroscope else GATE_ACCELEROMETER).names
    missing = sorted(set(needed) - set(names))
    if missing:
        raise ValueError(
            f"the gate for irregular motion needs the features {', '.join(missing)}, which the windows do not have: "
            "use windows with the feature set ATTITUDE_FREE"
        )
    return np.array([names.index(n) for n in needed])


def _gate(rows: dict[str, tuple[float, float, float]], intercept: float, still: dict[str, float]) -> IrregularGate:
    """Return the gate for rows of (mean, scale, weight) and limits of stillness, both by feature."""
    mean, scale, weight = np.array(list(rows.values())).T
    return IrregularGate(tuple(rows), mean, scale, weight, intercept, tuple(still), np.array(list(still.values())))


# Each row has the mean, scale and weight of a feature, fitted as described in the docstring of the module.
#
# A window is still if its vertical standard deviation is below exp(-1) - 0.02 = 0.35 m/s2 and the rate about its main
# axis of rotation is below exp(-1.6) - 0.005 = 0.20 rad/s. Without gyroscope, the second condition is a horizontal
# standard deviation below 0.35 m/s2. The subtracted floors are those of `invariant`. The rule holds for none of the
# 2948 walking windows of all thirteen persons, for 7 of 11 560 gait windows of the other sets (3 of 13 889 without
# gyroscope), and for 93 % (88 %) of sitting and standing in MotionSense.
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
