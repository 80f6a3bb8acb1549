"""Two soft quick steps that were found as one, as when somebody jogs slowly with the phone in the hand.

The default detector expects a cadence that goes with the power of the motion; who bounces softly 2.6 times a second is
expected at 1.6, and every second contact is passed over. What is found as one step then has two periods: its second
harmonic is the bounce. In walking it is the heel strike, and where it is more than twice the first, in some places of
the phone, it is weak.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pdr_filter.values import Step

# Single ones are stumbles and the ends of walks, about one in two walks.
_N_BEFORE, _MIN_ALIKE = 4, 2


@dataclass(frozen=True)
class DoubledSteps:
    """Makes two steps of one that holds two; causal, without delay.

    Parameters
    ----------
    min_ratio : float
        Second over first harmonic of the vertical, from which a step looks like two.
    min_amplitude_mps2 : float
        Second harmonic from which it does. In walks where the ratio is reached it is 0.3 to 1.1 m/s2 (quartiles of 13
        people with seven places of the phone), in slow jogging 1.8 to 3.0 (one person, two runs).
    min_duration_s : float
        Halves are no shorter than half of it: 3.6 steps a second.
    """

    min_ratio: float = 2.0
    min_amplitude_mps2: float = 1.5
    min_duration_s: float = 0.55

    def init(self) -> tuple[bool, ...]:
        """State before the first step: which of the last four look like two."""
        return ()

    def step(
        self, state: tuple[bool, ...], steps: Sequence[tuple[int, Step]]
    ) -> tuple[tuple[bool, ...], list[tuple[int, Step]]]:
        """New state, and the steps: one that looks like two is two if two of the four before look so."""
        found: list[tuple[int, Step]] = []
        for number, step in steps:
            looks = self._looks_like_two(step)
            is_two = looks and sum(state) >= _MIN_ALIKE
            found += [(number, one) for one in (_halves(step) if is_two else (step,))]
            state = (*state, looks)[-_N_BEFORE:]
        return state, found

    def _looks_like_two(self, step: Step) -> bool:
        strong = max(self.min_amplitude_mps2, self.min_ratio * step.vertical_amplitude_mps2)
        return step.second_amplitude_mps2 > strong and step.duration_s >= self.min_duration_s and not step.from_rest


def _halves(step: Step) -> tuple[Step, Step]:
    """The two steps of one; what the samples showed of the direction is said once."""
    half_s = 0.5 * step.duration_s
    first = replace(
        step,
        time_s=step.time_s - half_s,
        duration_s=half_s,
        frequency_hz=1.0 / half_s,
        heading_change_rad=0.5 * step.heading_change_rad,
        vertical_amplitude_mps2=step.second_amplitude_mps2,
    )
    said = {"heading_unknown_s": 0.0, "walking_heading_std_rad": np.inf, "offset_change_std_rad": 0.0}
    return first, replace(first, time_s=step.time_s, **said)
