"""The interface of a heading stage: where the person walked, step by step, as far as the samples show it."""

from __future__ import annotations

from typing import Any, Protocol

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.values import Step


class HeadingStage(Protocol):
    """A causal stage: `walking_heading_rad` of steps, its standard deviation, and `offset_change_std_rad`."""

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
