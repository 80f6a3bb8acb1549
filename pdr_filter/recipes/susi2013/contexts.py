"""Motion modes of a handheld device by a multivariate decision tree: Susi et al. 2013, sections 5 and 6.3.

Four classes (section 5): static; the arm at rest while its owner walks (texting, phoning, or the device in a bag held
in the hand); the device in a swinging hand; irregular motion that moves nobody. The tree asks whether it is static,
then whether somebody walks, then whether the arm swings (section 6.3); each node after the first is a linear test w . x
+ b > 0 of the six values of `tree_features`. docs/methods/susi2013.md has the deviations, and where it fails.

Where the numbers come from, and with which weights of the training sets:

- Static: no window of walking in the training sets is below both limits, and 94 % of MotionSense's sitting and
  standing (12 people) are.
- The tests are logistic regressions on standardised values, rounded to one decimal: both classes equally heavy, but
  walking three times as heavy as irregular motion (a step that is lost is not seen again).
- Irregular: what people 1 to 6 of ubicomp13 do with the phone more than 1 s before or after the walk (A. Brajdic and
  R. Harle, "Walk detection and step counting on unconstrained smartphones", UbiComp 2013,
  doi:10.1145/2493432.2493449). Only these weights are printed, nothing else of that data is here.
- Walking: the walks of these six (hand, bag, shirt 35 %, trouser pockets 10 %), texting and phoning of Tyrex without
  magnets (25 %), three recordings of humolire (`forward`, `straight`, `straight_reversed`, 10 %), swinging of Tyrex
  without magnets (15 %) and of 24 simulated people (5 %). Windows slower than 0.5 m/s (by Tyrex's motion capture) are
  left out.
- Swinging: Tyrex without magnets (60 %), simulated people (40 %): one real person. Against texting, phoning and bags of
  people 1 to 6 (50 %), Tyrex (30 %), humolire (20 %).
- Probabilities are the purities of the leaves on the training windows, every class with the same mass.

Without angular rate nothing shows a swinging arm: one test of three values separates walking from irregular motion, and
the four ways to hold a device stay equally probable.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pdr_filter.recipes.susi2013.features import NAMES, MotionWindow, MotionWindows, MotionWindowState
from pdr_filter.sensing.contexts.context_stage import WindowContext, WindowStage, known_context
from pdr_filter.values import FloatArray, check_numbers, check_transition_prob, replace_unchecked

MODES: tuple[str, ...] = ("static", "arm_at_rest", "swinging", "irregular")
TREE_FEATURES: tuple[str, ...] = (
    "log_variance_acc",
    "log_variance_gyro",
    "log_rotation_energy",
    "dominance_acc",
    "dominance_gyro",
    "log_ratio_to_gait_acc",
)
# Variances of a phone that lies still are near 1e-4 (m/s2)^2 or (rad/s)^2: below, a logarithm is of sensor noise.
_MIN_VARIANCE = 1e-4
# Steps a second of normal walking, and the least frequency that counts as one.
_GAIT_HZ, _MIN_FREQUENCY_HZ = 1.8, 0.2
_CONTEXTS = ("stationary", "walking")
# The ways to hold a device in which its arm does not swing; the paper knows no pocket.
_AT_REST = ("texting", "calling", "bag")


def tree_features(window: MotionWindow) -> FloatArray:
    """What the nodes of the tree test, (6,), in the order of `TREE_FEATURES`.

    Logarithms of the variances of |f| (m/s2) and |omega| (rad/s) and of the mean square of |omega|; how much of each
    is its dominant frequencies; and |ln(f_1 / 1.8 Hz)| of the dominant frequency of |f|.
    """
    variance = window.features[[_VARIANCE_ACC, _VARIANCE_GYRO]]
    log_energy = np.log(np.maximum([*variance, window.rotation_energy], _MIN_VARIANCE))
    frequency_hz = max(float(window.features[_FREQUENCY_ACC]), _MIN_FREQUENCY_HZ)
    return np.array([*log_energy, *window.dominance, abs(np.log(frequency_hz / _GAIT_HZ))])


_VARIANCE_ACC, _VARIANCE_GYRO = NAMES.index("variance_acc"), NAMES.index("variance_gyro")
_FREQUENCY_ACC = NAMES.index("dominant_frequency_1_acc_hz")


@dataclass(frozen=True)
class Node:
    """A multivariate test of a window: w . x + b > 0, x as in `TREE_FEATURES`."""

    weights: tuple[float, ...]
    bias: float

    def __post_init__(self) -> None:
        check_numbers(self, signed=("weights", "bias"))
        if len(self.weights) != len(TREE_FEATURES):
            raise ValueError(f"weights must be one for each of {TREE_FEATURES}, got {self.weights}")

    def passes(self, features: FloatArray) -> bool:
        """Whether features (6,) pass."""
        return float((np.asarray(self.weights) * features).sum()) + self.bias > 0


@dataclass(frozen=True)
class MotionModeTree:
    """Thresholds and leaves of the decision tree; one with, one without angular rate."""

    name: str  # on the windows that it classified
    static_variance_acc: float  # below this in (m/s2)^2, and
    static_variance_gyro: float  # below this in (rad/s)^2, a device is static
    walking: Node  # not irregular
    swinging: Node  # walking with a swinging arm
    leaves: tuple[tuple[float, ...], ...]  # probability of each of `MODES` (columns) in the leaf of each (rows)

    def __post_init__(self) -> None:
        check_numbers(self, infinite=("static_variance_acc", "static_variance_gyro"))
        check_transition_prob(np.array(self.leaves), len(MODES), "leaves")

    def classify(self, window: MotionWindow) -> str:
        """The motion mode, one of `MODES`."""
        variance_acc, variance_gyro = (float(window.features[i]) for i in (_VARIANCE_ACC, _VARIANCE_GYRO))
        if variance_acc < self.static_variance_acc and variance_gyro < self.static_variance_gyro:
            return "static"
        features = tree_features(window)
        if not self.walking.passes(features):
            return "irregular"
        return "swinging" if self.swinging.passes(features) else "arm_at_rest"

    def prob(self, mode: str) -> dict[str, float]:
        """Probability of each of `MODES` in the leaf of `mode`."""
        return dict(zip(MODES, self.leaves[MODES.index(mode)], strict=True))


TREE = MotionModeTree(
    "susi2013",
    static_variance_acc=0.05,
    static_variance_gyro=0.03,
    walking=Node((2.2, -4.5, 3.5, 8.0, 2.6, -1.0), -12.9),
    swinging=Node((-1.2, -3.3, 7.8, -3.1, -1.0, 0.0), -3.5),
    leaves=((1.0, 0.0, 0.0, 0.0), (0.0, 0.88, 0.05, 0.07), (0.0, 0.06, 0.90, 0.04), (0.06, 0.03, 0.02, 0.89)),
)
# Without angular rate a walking window is one of four ways to hold a device, of which one swings; no window swings.
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
    """Motion mode of every window as context, carrying mode and irregular motion; a `ContextStage`.

    Static is stationary. An arm at rest is walking, with texting, calling and a bag alike; a swinging one is walking
    and swinging. Irregular motion is stationary with `irregular_prob`: nobody goes anywhere. Running and stairs count
    as walking. Where nobody walks the device may be held in any of the four ways.
    """

    windows: MotionWindows = field(default_factory=MotionWindows)
    with_gyroscope: MotionModeTree = TREE
    without_gyroscope: MotionModeTree = TREE_ACCELEROMETER

    def first_memory(self) -> None:
        """Every window stands alone."""

    def assess(self, memory: None, window: MotionWindow) -> tuple[None, WindowContext]:
        """The result for a window."""
        tree = self.with_gyroscope if window.has_gyroscope else self.without_gyroscope
        p = tree.prob(tree.classify(window))
        walking = p["arm_at_rest"] + p["swinging"]
        context = {"stationary": p["static"] + p["irregular"], "walking": walking}
        swinging = p["swinging"] / walking if walking > 0.5 else 0.25
        carrying = {"swinging": swinging, **dict.fromkeys(_AT_REST, (1 - swinging) / len(_AT_REST))}
        known = known_context(window.time_s, context, carrying, _CONTEXTS, tree.name)
        return memory, replace_unchecked(known, irregular_prob=p["irregular"])
