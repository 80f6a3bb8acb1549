"""Context stage of Susi et al. 2013, sections 5 and 6.3: motion modes of a handheld device by a decision tree.

There are four motion modes (section 5): static; walking with the arm at rest (texting, phoning, or the device in a bag
in the hand); walking with the device in a swinging hand; and irregular motion without displacement. The tree tests in
turn whether the device is static, whether the person walks, and whether the arm swings (section 6.3). Each node after
the first is a linear test w . x + b > 0 of the six values of `tree_features`. `MotionModes` lists the deviations from
the paper.

Sources of the numbers, and weights of the training sets:

- Static: no walking window of the training sets is below both limits, but 94 % of the sitting and standing windows of
  MotionSense (12 persons) are.
- The tests are logistic regressions on standardised values, rounded to one decimal. Both classes have the same weight,
  except that walking has three times the weight of irregular motion, because a lost step cannot be recovered.
- Irregular: motions of the phone more than 1 s before or after the walk, by persons 1 to 6 of ubicomp13 (A. Brajdic and
  R. Harle, "Walk detection and step counting on unconstrained smartphones", UbiComp 2013,
  doi:10.1145/2493432.2493449). This file contains only the fitted weights and no other data of that set.
- Walking: the walks of these six persons (hand, bag, shirt 35 %, trouser pockets 10 %), texting and phoning of Tyrex
  without magnets (25 %), three recordings of humolire (`forward`, `straight`, `straight_reversed`, 10 %), swinging of
  Tyrex without magnets (15 %) and of 24 simulated persons (5 %). Windows slower than 0.5 m/s (by the motion capture of
  Tyrex) are excluded.
- Swinging: Tyrex without magnets (60 %, one real person) and simulated persons (40 %), against texting, phoning and
  bags of persons 1 to 6 (50 %), Tyrex (30 %) and humolire (20 %).
- Probabilities are the purities of the leaves on the training windows, with the same total weight for every class.

Without angular rate, a swinging arm cannot be detected. One test of three values then separates walking from irregular
motion, and the four ways of holding a device are equally probable.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pdr_filter.recipes.susi2013.features import NAMES, MotionWindow, MotionWindows, MotionWindowState
from pdr_filter.sensing.contexts.context_stage import WindowStage
from pdr_filter.values import (
    FloatArray,
    WindowContext,
    check_numbers,
    check_transition_prob,
    known_context,
    replace_unchecked,
)

MODES: tuple[str, ...] = ("static", "arm_at_rest", "swinging", "irregular")
TREE_FEATURES: tuple[str, ...] = (
    "log_variance_acc",
    "log_variance_gyro",
    "log_rotation_energy",
    "dominance_acc",
    "dominance_gyro",
    "log_ratio_to_gait_acc",
)
# Lower limit of variances before the logarithm. A phone at rest has about 1e-4 (m/s2)^2 or (rad/s)^2, which is sensor
# noise.
_MIN_VARIANCE = 1e-4
# Step frequency of normal walking, and lower limit of frequencies before the logarithm.
_GAIT_HZ, _MIN_FREQUENCY_HZ = 1.8, 0.2
_CONTEXTS = ("stationary", "walking")
# Carrying modes with the arm at rest. The paper does not consider pockets.
_AT_REST = ("texting", "calling", "bag")


def tree_features(window: MotionWindow) -> FloatArray:
    """Return the features that the nodes of the tree test, (6,), in the order of `TREE_FEATURES`.

    They are the logarithms of the variances of |f| (m/s2) and |omega| (rad/s) and of the mean square of |omega|, the
    shares of power in the dominant frequencies of |f| and |omega|, and |ln(f_1 / 1.8 Hz)| for the dominant frequency
    f_1 of |f|.
    """
    variance = window.features[[_VARIANCE_ACC, _VARIANCE_GYRO]]
    log_energy = np.log(np.maximum([*variance, window.rotation_energy], _MIN_VARIANCE))
    frequency_hz = max(float(window.features[_FREQUENCY_ACC]), _MIN_FREQUENCY_HZ)
    return np.array([*log_energy, *window.dominance, abs(np.log(frequency_hz / _GAIT_HZ))])


_VARIANCE_ACC, _VARIANCE_GYRO = NAMES.index("variance_acc"), NAMES.index("variance_gyro")
_FREQUENCY_ACC = NAMES.index("dominant_frequency_1_acc_hz")


@dataclass(frozen=True)
class Node:
    """Node of the decision tree, with the linear test w . x + b > 0.

    w are weights and b is a bias. x are the features in the order of `TREE_FEATURES`.
    """

    weights: tuple[float, ...]
    bias: float

    def __post_init__(self) -> None:
        check_numbers(self, signed=("weights", "bias"))
        if len(self.weights) != len(TREE_FEATURES):
            raise ValueError(f"weights must have one value for each of {TREE_FEATURES}, got {self.weights}")

    def passes(self, features: FloatArray) -> bool:
        """Return True if features (6,) pass the test."""
        return float((np.asarray(self.weights) * features).sum()) + self.bias > 0


@dataclass(frozen=True)
class MotionModeTree:
    """Decision tree of the motion modes."""

    name: str  # name of the tree in the reports of windows
    # limits of the variances of |f|, (m/s2)^2, and |omega|, (rad/s)^2. A device below both is static.
    static_variance_acc: float
    static_variance_gyro: float
    walking: Node  # test for walking against irregular motion
    swinging: Node  # test for a swinging arm against an arm at rest
    leaves: tuple[tuple[float, ...], ...]  # probabilities of the `MODES` (columns) in the leaf of each mode (rows)

    def __post_init__(self) -> None:
        check_numbers(self, infinite=("static_variance_acc", "static_variance_gyro"))
        check_transition_prob(np.array(self.leaves), len(MODES), "leaves")

    def classify(self, window: MotionWindow) -> str:
        """Return the motion mode of a window, one of `MODES`."""
        variance_acc, variance_gyro = (float(window.features[i]) for i in (_VARIANCE_ACC, _VARIANCE_GYRO))
        if variance_acc < self.static_variance_acc and variance_gyro < self.static_variance_gyro:
            return "static"
        features = tree_features(window)
        if not self.walking.passes(features):
            return "irregular"
        return "swinging" if self.swinging.passes(features) else "arm_at_rest"

    def prob(self, mode: str) -> dict[str, float]:
        """Return the probability of each of `MODES` in the leaf of `mode`."""
        return dict(zip(MODES, self.leaves[MODES.index(mode)], strict=True))


TREE = MotionModeTree(
    "susi2013",
    static_variance_acc=0.05,
    static_variance_gyro=0.03,
    walking=Node((2.2, -4.5, 3.5, 8.0, 2.6, -1.0), -12.9),
    swinging=Node((-1.2, -3.3, 7.8, -3.1, -1.0, 0.0), -3.5),
    leaves=((1.0, 0.0, 0.0, 0.0), (0.0, 0.88, 0.05, 0.07), (0.0, 0.06, 0.90, 0.04), (0.06, 0.03, 0.02, 0.89)),
)
# Without angular rate no window is classified as swinging. Walking windows belong equally to four ways of holding the
# device, one of which is swinging.
TREE_ACCELEROMETER = MotionModeTree(
    "susi2013_accelerometer",
    static_variance_acc=0.05,
    static_variance_gyro=np.inf,
    walking=Node((1.2, 0.0, 0.0, 12.2, 0.0, -1.0), -7.4),
    swinging=Node((0.0,) * 6, -1.0),
    leaves=((0.90, 0.0, 0.0, 0.10), (0.0, 0.66, 0.22, 0.12), (0.0, 0.66, 0.22, 0.12), (0.05, 0.12, 0.04, 0.79)),
)


@dataclass(frozen=True, eq=False)
class MotionModes(WindowStage[MotionWindowState, MotionWindow, None]):
    """Context stage of Susi et al. 2013, which converts motion modes to context and carrying mode.

    Static is the context "stationary". An arm at rest is "walking", with equal probabilities of texting, calling and
    bag. A swinging hand is "walking" with the carrying mode "swinging". Irregular motion is "stationary" with
    `irregular_prob`, because it has no displacement. Running and stairs count as walking. The probabilities of the four
    modes come from the leaf that a window reaches (`MotionModeTree.leaves`). If walking is improbable, texting,
    calling, bag and swinging are equally probable.

    Parameters
    ----------
    windows : MotionWindows
        Windows and their features.
    with_gyroscope, without_gyroscope : MotionModeTree
        Decision trees for windows with and without angular rate.

    Notes
    -----
    Deviations from the paper:

    - The thresholds of the tree are not printed and its data is not public. It is trained on public recordings.
    - The "presence" of peaks in the spectrum is the share of the power in the three highest.
    - The paper takes the energy of |omega| with or without its mean. Here the tree uses both: the variance without the
      mean, and the mean square with it, because figure 2 needs the mean.
    - The result is not a class, but the purities of the leaf, because the filter needs probabilities.
    - Swinging is trained on one person and on simulated ones. The paper has four people.
    - Irregular motion is a phone taken out, started or put away, as in public data. In the paper a person searches a
      bag.
    - Recordings without a gyroscope do not occur in the paper. They have a tree of three values without a swinging
      mode.
    - Pockets, stairs and running do not occur in the paper. A swinging thigh is classified as a swinging arm. Slow
      walking with the phone in the hand is often classified as irregular.

    Examples
    --------
    >>> from pdr_filter.recipes.susi2013.contexts import MotionModes
    >>> MotionModes().hop_s
    1.28
    """

    windows: MotionWindows = field(default_factory=MotionWindows)
    with_gyroscope: MotionModeTree = TREE
    without_gyroscope: MotionModeTree = TREE_ACCELEROMETER

    def first_memory(self) -> None:
        return None

    def assess(self, memory: None, window: MotionWindow) -> tuple[None, WindowContext]:
        tree = self.with_gyroscope if window.has_gyroscope else self.without_gyroscope
        p = tree.prob(tree.classify(window))
        walking = p["arm_at_rest"] + p["swinging"]
        context = {"stationary": p["static"] + p["irregular"], "walking": walking}
        swinging = p["swinging"] / walking if walking > 0.5 else 0.25
        carrying = {"swinging": swinging, **dict.fromkeys(_AT_REST, (1 - swinging) / len(_AT_REST))}
        known = known_context(window.time_s, context, carrying, _CONTEXTS, tree.name)
        return memory, replace_unchecked(known, irregular_prob=p["irregular"])
