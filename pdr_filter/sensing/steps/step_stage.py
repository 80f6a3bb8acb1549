"""Interface of a stage that receives the detected steps, and changes, delays, rejects or divides them."""

from __future__ import annotations

from typing import Any, Protocol

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.values import Step


class StepStage(Protocol):
    """Interface of a causal stage between the step detector and the filter, such as the gate or the heading stage.

    It is also the base class of stages without memory, which define `finish` only.

    Examples
    --------
    A stage that rejects short steps:

    >>> import pdr_filter as pdr
    >>> from pdr_filter.sensing.steps.step_stage import StepStage
    >>> class LongSteps(StepStage):
    ...     def finish(self, state, steps):
    ...         return state, [(number, step) for number, step in steps if step.duration_s > 0.3]
    >>> step = pdr.Step(0.0, 0.0, 0.2, 5.0, 4.0, 2.0, -2.0, 12.0, 8.0, 1.0, 0.0, 0.0)
    >>> LongSteps().finish(None, [(9, step)])
    (None, [])
    """

    def init(self) -> Any:
        """Return the state before the first sample.

        Returns
        -------
        object
            Initial state.
        """
        return None

    def after_gap(self, state: Any) -> Any:
        """Return the state after a gap, during which the phone may have been turned in an unknown way.

        Parameters
        ----------
        state : object
            State before the gap, after `finish`.

        Returns
        -------
        object
            State before the first sample after the gap.
        """
        return state

    def update(
        self,
        state: Any,
        block: UniformBlock,
        attitude: AttitudeBlock,
        contexts: ContextBlock,
        steps: list[tuple[int, Step]],
    ) -> tuple[Any, list[tuple[int, Step]]]:
        """Return the new state and the steps that the stage releases after a block.

        Parameters
        ----------
        state : object
            State after the previous block.
        block : UniformBlock
            Uniform samples of the block.
        attitude : AttitudeBlock
            Attitude at these samples.
        contexts : ContextBlock
            Most probable context and carrying mode at each sample.
        steps : list of (int, Step)
            Steps that became known in this block, each with the number in the segment of the sample that revealed it.
            The contact may be seconds earlier.

        Returns
        -------
        state : object
            New state.
        steps : list of (int, Step)
            Steps as this stage changes them, which may depend only on samples up to the one with their number. A
            heading stage returns the same steps with their walking headings.
        """
        return self.finish(state, steps)

    def finish(self, state: Any, steps: list[tuple[int, Step]]) -> tuple[Any, list[tuple[int, Step]]]:
        """Return the new state and the steps that the stage releases at a gap or the end.

        Parameters
        ----------
        state : object
            State after the last block.
        steps : list of (int, Step)
            Steps that the stages before this one released at the gap or the end.

        Returns
        -------
        state : object
            New state.
        steps : list of (int, Step)
            Steps as this stage changes them. None may wait any longer.
        """
        ...
