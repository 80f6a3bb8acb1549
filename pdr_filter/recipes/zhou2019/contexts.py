"""Standing, walking, running or irregular swing by a state machine: Zhou et al. 2019, section III, Table 1.

The machine keeps its behaviour while the maximum of the filtered acceleration stays as it was (Condition 1). When it
changes (Condition 2), features decide again: running by the DC component (6), else walking by variance and energy (5),
else irregular swing by the DC component and energy (4), else standing (3). Deviations: docs/methods/zhou2019.md.

The thresholds are trained (`FOOT`, `CARRIED`). The transition state lasts until a window that holds nothing from before
the change was classified; windows of 2 s follow each other every second.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from pdr_filter.recipes.zhou2019.features import BehaviourState, BehaviourWindow, BehaviourWindows
from pdr_filter.sensing.contexts.context_stage import WindowContext, WindowStage, known_context
from pdr_filter.values import FloatArray, check_numbers, replace_unchecked

BEHAVIOURS: tuple[str, ...] = ("standing", "walking", "running", "irregular")
# In irregular swing nobody moves.
_CONTEXT_OF = {"standing": "stationary", "walking": "walking", "running": "running", "irregular": "stationary"}
_CONTEXTS_KNOWN = ("stationary", "walking", "running")
_NAME = "Zhou et al. 2019, Table 1"


@dataclass(frozen=True)
class BehaviourThresholds:
    """Thresholds of Table 1 for one place of the sensor."""

    max_change_mps2: float  # T_a of Condition 1
    running_dc_mps2: float  # T_f^R of Condition 6
    walking_variance: float  # T_sigma^W of Condition 5, m2/s4
    walking_energy: float  # T_E^W of Condition 5, m/s2
    irregular_dc_mps2: float  # T_f^I of Condition 4
    irregular_energy: float  # T_E^I of Condition 4, m/s2

    def __post_init__(self) -> None:
        check_numbers(self, zero=("max_change_mps2",), signed=("irregular_dc_mps2",))

    def classify(self, features: FloatArray) -> str:
        """Behaviour of the features (3,) of a window: Conditions 6, 5, 4, 3, in this order."""
        variance, dc_component, energy = features
        if dc_component > self.running_dc_mps2:
            return "running"
        if variance > self.walking_variance and energy > self.walking_energy:
            return "walking"
        if dc_component > self.irregular_dc_mps2 and energy > self.irregular_energy:
            return "irregular"
        return "standing"


# On the foot, from the 24 trials of pyshoe, behaviour by the speed of the foot in motion capture (windows of 2 s):
# standing (19 windows) has a variance below 0.02, |f_0| below 0.03 and an energy below 0.6; walking at 0.2 to 1.5 m/s,
# sideways and backwards too (647), at least 0.76 and 5.0, f_0 at most 8.9; the one trial that runs, at 1.8 m/s (11),
# f_0 7.4 to 12.1. T^W is below the slowest walking, T_f^R where the sum of both errors is smallest, T^I above standing.
# Nobody swings a foot irregularly there: what is neither walking nor standing is called so.
FOOT = BehaviourThresholds(
    max_change_mps2=1.0,
    running_dc_mps2=8.5,
    walking_variance=0.6,
    walking_energy=4.0,
    irregular_dc_mps2=0.05,
    irregular_energy=1.0,
)

# Elsewhere on the body, from persons 1 to 6 of motionsense (front pocket: sitting, standing, walking, stairs, jogging)
# and of ubicomp13 (seven places: walking, and the phone handled while nobody walks): T_f^R has the best mean recall of
# standing, walking and running; T^W the smallest count error of `steps.zhou.CARRIED`, and the fewest false steps with
# it; T_E^I is above 97 % of sitting and standing. f_0 at rest is the error of the accelerometer's scale, down to -0.7
# on these phones: T_f^I lets all pass.
CARRIED = BehaviourThresholds(
    max_change_mps2=0.5,
    running_dc_mps2=2.2,
    walking_variance=0.3,
    walking_energy=3.0,
    irregular_dc_mps2=-1.0,
    irregular_energy=1.5,
)


@dataclass(frozen=True, slots=True)
class BehaviourMemory:
    """Where the machine is."""

    behaviour: str  # of BEHAVIOURS; empty before the first window
    last_max_mps2: tuple[float, ...]  # of the windows of the last window length, oldest first
    n_transition: int  # windows that the transition state still lasts


@dataclass(frozen=True, eq=False)
class BehaviourStage(WindowStage[BehaviourState, BehaviourWindow, BehaviourMemory]):
    """Causal stage of the behaviours; a `ContextStage`. After a gap the behaviour has to show again.

    The window is a whole number of hops.
    """

    windows: BehaviourWindows = field(default_factory=lambda: BehaviourWindows(hop_s=1.0))
    thresholds: BehaviourThresholds = field(kw_only=True)

    def __post_init__(self) -> None:
        if self.windows.window_samples % self.windows.hop_samples:
            raise ValueError(
                f"window_s must be a whole number of hops, got {self.windows.window_s} and {self.windows.hop_s}"
            )

    def first_memory(self) -> BehaviourMemory:
        """No behaviour has shown."""
        return BehaviourMemory("", (), 0)

    def assess(self, memory: BehaviourMemory, window: BehaviourWindow) -> tuple[BehaviourMemory, WindowContext]:
        """One cycle of Table 1."""
        # windows from one to the first that shares no sample with it
        n = self.windows.window_samples // self.windows.hop_samples
        behaviour, last_max, n_transition = memory.behaviour, memory.last_max_mps2, memory.n_transition
        is_known = len(last_max) == n  # whether there is a previous window
        is_kept = is_known and abs(window.max_mps2 - last_max[0]) < self.thresholds.max_change_mps2  # Condition 1
        n_transition = max(n_transition - 1, 0) if is_kept else n
        if n_transition or not is_kept:
            behaviour = self.thresholds.classify(window.features)
        memory = BehaviourMemory(behaviour, (*last_max, window.max_mps2)[-n:], n_transition)
        return memory, context_of(behaviour, window.time_s)


def context_of(behaviour: str, time_s: float) -> WindowContext:
    """The context of a behaviour, of the window that ends at a time."""
    known = known_context(time_s, {_CONTEXT_OF[behaviour]: 1.0}, {}, _CONTEXTS_KNOWN, _NAME)
    return replace_unchecked(known, irregular_prob=float(behaviour == "irregular"))
