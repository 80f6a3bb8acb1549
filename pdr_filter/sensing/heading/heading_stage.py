"""The interface of a heading stage: where the person walked, step by step, as far as the samples show it."""

from __future__ import annotations

import math
from typing import Any, Protocol

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.values import HeadingDrift, Step, Table, replace_unchecked


class HeadingStage(Protocol):
    """A causal stage: `walking_heading_rad` of steps, its standard deviation, and `offset_change_std_rad`.

    `config.with_heading` takes one, and `pdr_filter.testing.check_stage` tests it. Headings are in rad, clockwise, with
    the zero of `Step.device_heading_rad`. Further attributes are optional:

    - `drift`, a `HeadingDrift` that must be that of the filter.
    - `learns_directions`: True if the stage sets `Step.shown_offset_rad`, which the magnetic north needs; False if
      north must not be used with it. Without this attribute the offset shown by a step is its walking heading less its
      device heading.
    - `drift_in_time(state)`: error of the device's heading that time has added, rad, and its variance.
    - `after_first_pass(steps)`: the stage for a second pass over a whole recording, given the table of its steps.
    """

    def init(self) -> Any:
        """State before the first sample."""
        ...

    def after_gap(self, state: Any) -> Any:
        """State after a time without samples: nothing is known of how the phone was turned in it."""
        ...

    def update(
        self,
        state: Any,
        block: UniformBlock,
        attitude: AttitudeBlock,
        contexts: ContextBlock,
        steps: list[tuple[int, Step]],
    ) -> tuple[Any, list[tuple[int, Step]]]:
        """New state and the steps of a block with their walking headings.

        `steps` are those that became known in this block, with the number (in the segment) of the sample that revealed
        each, maybe seconds after its contact; the direction of a step depends on samples up to that one only.
        """
        ...

    def finish(self, state: Any, steps: list[tuple[int, Step]]) -> tuple[Any, list[tuple[int, Step]]]:
        """The same for steps that a gap or the end revealed."""
        ...


def drift_of(stage: HeadingStage | None) -> HeadingDrift | None:
    """The drift that a stage reckons with; None if it states none."""
    return getattr(stage, "drift", None)


def learns_directions(stage: HeadingStage | None) -> bool:
    """True if the steps of a stage say where the person walks against the phone."""
    return stage is not None and bool(getattr(stage, "learns_directions", True))


def drift_in_time(stage: HeadingStage | None, state: Any) -> tuple[float, float]:
    """What time has added to the device's heading, rad, and its variance: infinite if the stage does not know it."""
    of_stage = getattr(stage, "drift_in_time", None)
    return (0.0, math.inf) if of_stage is None else of_stage(state)


def after_first_pass(stage: HeadingStage | None, steps: Table) -> HeadingStage | None:
    """The stage for a second pass; itself if it learns nothing from the first."""
    of_stage = getattr(stage, "after_first_pass", None)
    return stage if of_stage is None else of_stage(steps)


def with_shown_offsets(stage: HeadingStage, steps: list[tuple[int, Step]]) -> list[tuple[int, Step]]:
    """Steps whose shown offset is that of their walking heading, if the stage does not say what it shows."""
    if hasattr(stage, "learns_directions"):
        return steps
    return [
        (
            number,
            replace_unchecked(
                step,
                shown_offset_rad=step.walking_heading_rad - step.device_heading_rad,
                shown_offset_std_rad=step.walking_heading_std_rad,
            ),
        )
        for number, step in steps
    ]
