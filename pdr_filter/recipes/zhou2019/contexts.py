"""Context stage of Zhou et al. 2019, section III, Table 1: a state machine for standing, walking, running and swing.

The behaviour is kept while the maximum of the filtered acceleration is unchanged (Condition 1). After a change
(Condition 2) the features are classified again: running by the DC component (Condition 6), else walking by variance
and energy (5), else irregular swing by DC component and energy (4), else standing (3). `BehaviourStage` lists the
deviations from the paper. `FOOT` and `CARRIED` are the thresholds.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from pdr_filter.recipes.zhou2019.features import BehaviourState, BehaviourWindow, BehaviourWindows
from pdr_filter.sensing.contexts.context_stage import WindowStage
from pdr_filter.values import FloatArray, WindowContext, check_numbers, known_context, replace_unchecked

BEHAVIOURS: tuple[str, ...] = ("standing", "walking", "running", "irregular")
# Irregular swing has no displacement.
_CONTEXT_OF = {"standing": "stationary", "walking": "walking", "running": "running", "irregular": "stationary"}
_CONTEXTS_KNOWN = ("stationary", "walking", "running")
_NAME = "Zhou et al. 2019, Table 1"


@dataclass(frozen=True)
class BehaviourThresholds:
    """Thresholds of the behaviours (Zhou et al. 2019, Table 1) for one placement of the sensor.

    The signal is the low-passed acceleration a = |f| - g in a window. The behaviours are standing, walking, running and
    irregular swing.
    """

    # largest change of the maximum of a between two windows at which the behaviour is kept, T_a of Condition 1
    max_change_mps2: float
    running_dc_mps2: float  # smallest DC component (mean of a) of running, T_f^R of Condition 6
    # smallest variance in m2/s4 and smallest energy (mean absolute Fourier coefficient) in m/s2 of walking, T_sigma^W
    # and T_E^W of Condition 5
    walking_variance: float
    walking_energy: float
    # smallest DC component and energy in m/s2 of irregular swing, T_f^I and T_E^I of Condition 4
    irregular_dc_mps2: float
    irregular_energy: float

    def __post_init__(self) -> None:
        check_numbers(self, zero=("max_change_mps2",), signed=("irregular_dc_mps2",))

    def classify(self, features: FloatArray) -> str:
        """Return the behaviour for the features (3,) of a window: variance, DC component and energy.

        It is running if the DC component exceeds its threshold (Condition 6). Otherwise it is walking if variance and
        energy exceed theirs (Condition 5), or irregular if DC component and energy do (Condition 4). Otherwise it is
        standing (Condition 3). Table 1 of Zhou et al. 2019 has the conditions.
        """
        variance, dc_component, energy = features
        if dc_component > self.running_dc_mps2:
            return "running"
        if variance > self.walking_variance and energy > self.walking_energy:
            return "walking"
        if dc_component > self.irregular_dc_mps2 and energy > self.irregular_energy:
            return "irregular"
        return "standing"


# Thresholds on the foot, from the 24 trials of pyshoe with the foot speed of motion capture (windows of 2 s). Standing
# (19 windows) has a variance below 0.02, |f_0| below 0.03 and an energy below 0.6. Walking at 0.2 to 1.5 m/s, also
# sideways and backwards (647 windows), has at least 0.76 and 5.0, and f_0 of at most 8.9. The only running trial, at
# 1.8 m/s (11 windows), has f_0 of 7.4 to 12.1. T^W is below the slowest walking, T_f^R minimises the sum of both
# errors, and T^I is above standing. The trials contain no irregular swing, which is here what is neither walking nor
# standing.
FOOT = BehaviourThresholds(
    max_change_mps2=1.0,
    running_dc_mps2=8.5,
    walking_variance=0.6,
    walking_energy=4.0,
    irregular_dc_mps2=0.05,
    irregular_energy=1.0,
)

# Thresholds elsewhere on the body, from persons 1 to 6 of motionsense (front pocket: sitting, standing, walking,
# stairs, jogging) and of ubicomp13 (seven placements: walking, and handling of the phone without walking). T_f^R gives
# the best mean recall of standing, walking and running. T^W gives the smallest count error of `steps.CARRIED` with the
# fewest false steps. T_E^I is above 97 % of sitting and standing. f_0 at rest is the scale error of the accelerometer,
# down to -0.7 on these phones, so that T_f^I has no effect.
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
    """State of the machine of Zhou et al. 2019, Table 1, that recognises behaviours.

    The behaviour stays the same while the maximum of the acceleration does. After a change of the maximum, the
    behaviour is classified in this window and in the following windows that overlap it.
    """

    behaviour: str  # one of BEHAVIOURS; empty before the first window
    last_max_mps2: tuple[float, ...]  # maxima of the windows within the last window length, oldest first
    n_transition: int  # remaining windows of the transition state


@dataclass(frozen=True, eq=False)
class BehaviourStage(WindowStage[BehaviourState, BehaviourWindow, BehaviourMemory]):
    """Context stage of Zhou et al. 2019, which reports the behaviour of each window.

    After a gap the behaviour is classified again.

    Parameters
    ----------
    windows : BehaviourWindows
        Windows and their features. The window length must be a multiple of the hop.
    thresholds : BehaviourThresholds
        Thresholds for the placement of the sensor, `FOOT` or `CARRIED`.

    Raises
    ------
    ValueError
        If the window length is not a multiple of the hop.

    Notes
    -----
    Deviations from the paper:

    - The thresholds of Table 1 are not printed. They are trained, with one set for the foot and one for other places.
    - Windows of 2 s follow each other in the paper. Here they overlap by 1 s, so that a context is reported every
      second. Condition 1 compares the maxima of two windows without common samples.
    - The transition state lasts one cycle in the paper. Here it ends with the first classified window without samples
      from before the change. Otherwise a mixture of two behaviours would be kept.
    - The filter of the features is not given. Its cutoff is 10 Hz and its length 0.5 s.
    - The bias, DC component and energy are described in `pdr_filter.recipes.zhou2019.features`.

    Examples
    --------
    >>> from pdr_filter.recipes.zhou2019.contexts import CARRIED, BehaviourStage
    >>> BehaviourStage(thresholds=CARRIED).hop_s
    1.0
    """

    windows: BehaviourWindows = field(default_factory=lambda: BehaviourWindows(hop_s=1.0))
    thresholds: BehaviourThresholds = field(kw_only=True)

    def __post_init__(self) -> None:
        if self.windows.window_samples % self.windows.hop_samples:
            raise ValueError(
                f"window_s must be a multiple of hop_s, got {self.windows.window_s} and {self.windows.hop_s}"
            )

    def first_memory(self) -> BehaviourMemory:
        return BehaviourMemory("", (), 0)

    def assess(self, memory: BehaviourMemory, window: BehaviourWindow) -> tuple[BehaviourMemory, WindowContext]:
        # number of hops from a window to the next window without common samples
        n = self.windows.window_samples // self.windows.hop_samples
        behaviour, last_max, n_transition = memory.behaviour, memory.last_max_mps2, memory.n_transition
        is_known = len(last_max) == n  # True if there is a previous window without common samples
        is_kept = is_known and abs(window.max_mps2 - last_max[0]) < self.thresholds.max_change_mps2  # Condition 1
        n_transition = max(n_transition - 1, 0) if is_kept else n
        if n_transition or not is_kept:
            behaviour = self.thresholds.classify(window.features)
        memory = BehaviourMemory(behaviour, (*last_max, window.max_mps2)[-n:], n_transition)
        return memory, context_of(behaviour, window.time_s)


def context_of(behaviour: str, time_s: float) -> WindowContext:
    """Return the context of a behaviour with probability one, for a window that ends at `time_s`.

    Irregular swing is the context "stationary" with an `irregular_prob` of 1.
    """
    known = known_context(time_s, {_CONTEXT_OF[behaviour]: 1.0}, {}, _CONTEXTS_KNOWN, _NAME)
    return replace_unchecked(known, irregular_prob=float(behaviour == "irregular"))
