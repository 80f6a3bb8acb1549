"""Interface of a heading stage, which estimates the walking direction of each step."""

from __future__ import annotations

import math
from typing import Any, Protocol

from pdr_filter.sensing.steps.step_stage import S, StepStage
from pdr_filter.values import HeadingDrift, Step, Table, replace_unchecked


class HeadingStage(StepStage[S], Protocol[S]):
    """Interface of a causal stage that sets the walking headings of steps.

    The stage sets `Step.walking_heading_rad`, `Step.walking_heading_std_rad` and `Step.offset_change_std_rad`.
    `config.with_heading` uses such a stage, and `pdr_filter.testing.verify_stage` tests it. Headings are in rad,
    clockwise, with the zero of `Step.device_heading_rad`. A walking heading with a standard deviation above 0 measures
    the heading offset. One with a standard deviation of 0 states the direction of the step, as decided by a rule for
    each step. The filter then estimates only the error that all stated directions share, and a stage must state the
    directions of all steps. These further attributes are optional:

    - `drift`: a `HeadingDrift`, which must equal the `HeadingDrift` of the filter.
    - `learns_directions`: True if the stage sets `Step.shown_offset_rad`, which the magnetic north needs. False if
      north must not be used with the stage. Without this attribute, `shown_offset_rad` of a step is its walking heading
      minus its device heading.
    - `knows_north`: True if the stated directions are clockwise from true or magnetic north, which is then the frame of
      the track.
    - `drift_in_time(state)`: returns the error of the device heading accumulated over time, in rad, and its variance.
    - `after_first_pass(steps)`: returns the stage for a second pass over a whole recording, given the table of its
      steps.

    Examples
    --------
    A stage for a phone whose y axis always points in the walking direction:

    >>> from dataclasses import dataclass, replace
    >>> @dataclass(frozen=True)
    ... class DeviceHeading:
    ...     def init(self):
    ...         return 0
    ...     def after_gap(self, state):
    ...         return state
    ...     def update(self, state, block, attitude, contexts, steps):
    ...         return self.finish(state, steps)
    ...     def finish(self, state, steps):
    ...         def with_heading(step):
    ...             return replace(step, walking_heading_rad=step.device_heading_rad, walking_heading_std_rad=0.3)
    ...         return state, [(number, with_heading(step)) for number, step in steps]
    >>> import pdr_filter as pdr
    >>> config = pdr.recipes.default().with_heading(DeviceHeading())
    """


def drift_of(stage: HeadingStage[Any] | None) -> HeadingDrift | None:
    """Return the heading drift that a stage assumes, or None if it states none."""
    return getattr(stage, "drift", None)


def learns_directions(stage: HeadingStage[Any] | None) -> bool:
    """Return True if the steps of a stage tell the walking direction relative to the phone."""
    return stage is not None and bool(getattr(stage, "learns_directions", True))


def knows_north(stage: HeadingStage[Any] | None) -> bool:
    """Return True if a stage states directions from north."""
    return bool(getattr(stage, "knows_north", False))


def drift_in_time(stage: HeadingStage[Any] | None, state: Any) -> tuple[float, float]:
    """Return the error of the device heading accumulated over time, in rad, and its variance.

    The variance is infinite if the stage does not know the error.
    """
    of_stage = getattr(stage, "drift_in_time", None)
    return (0.0, math.inf) if of_stage is None else of_stage(state)


def after_first_pass(stage: HeadingStage[Any] | None, steps: Table) -> HeadingStage[Any] | None:
    """Return the stage for a second pass, or the same stage if it learns nothing from the first pass."""
    of_stage = getattr(stage, "after_first_pass", None)
    return stage if of_stage is None else of_stage(steps)


class ShownOffsets(StepStage[None]):
    """Stage that sets `Step.shown_offset_rad` from the walking heading, for a heading stage that does not set it."""

    def finish(self, state: None, steps: list[tuple[int, Step]]) -> tuple[None, list[tuple[int, Step]]]:
        """Return the steps with `shown_offset_rad` and its standard deviation, which is infinite for stated ones."""
        return None, [
            (
                number,
                replace_unchecked(
                    step,
                    shown_offset_rad=step.walking_heading_rad - step.device_heading_rad,
                    shown_offset_std_rad=math.inf if step.states_heading else step.walking_heading_std_rad,
                ),
            )
            for number, step in steps
        ]
