"""Interface of a stage that receives the detected steps, and changes, delays, rejects or divides them."""

from __future__ import annotations

from typing import Any, Protocol, TypeVar

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.values import Step

S = TypeVar("S")  # type of the state
_WITHOUT_MEMORY: Any = None  # state of a stage without memory, whose type S is that of None


class StepStage(Protocol[S]):
    """Interface of a causal stage between the step detector and the filter, such as the gate or the heading stage.

    It is also the base class of stages without memory, which define `finish` only.

    Examples
    --------
    A stage that rejects short steps:

    >>> import pdr_filter as pdr
    >>> from pdr_filter.sensing.steps.step_stage import StepStage
    >>> class LongSteps(StepStage[None]):
    ...     def finish(self, state, steps):
    ...         return state, [(number, step) for number, step in steps if step.duration_s > 0.3]
    >>> step = pdr.Step(0.0, 0.0, 0.2, 5.0, 4.0, 2.0, -2.0, 12.0, 8.0, 1.0, 0.0, 0.0)
    >>> LongSteps().finish(None, [(9, step)])
    (None, [])
    """

    def init(self) -> S:
        """Return the state before the first sample.

        Returns
        -------
        S
            Initial state.
        """
        return _WITHOUT_MEMORY

    def after_gap(self, state: S) -> S:
        """Return the state after a gap, during which the phone may have been turned in an unknown way.

        Parameters
        ----------
        state : S
            State before the gap, after `finish`.

        Returns
        -------
        S
            State before the first sample after the gap.
        """
        return state

    def update(
        self,
        state: S,
        block: UniformBlock,
        attitude: AttitudeBlock,
        contexts: ContextBlock,
        steps: list[tuple[int, Step]],
    ) -> tuple[S, list[tuple[int, Step]]]:
        """Return the new state and the steps that the stage releases after a block.

        Parameters
        ----------
        state : S
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
        state : S
            New state.
        steps : list of (int, Step)
            Steps as this stage changes them, which may depend only on samples up to the one with their number. A
            heading stage returns the same steps with their walking headings.
        """
        return self.finish(state, steps)

    def finish(self, state: S, steps: list[tuple[int, Step]]) -> tuple[S, list[tuple[int, Step]]]:
        """Return the new state and the steps that the stage releases at a gap or the end.

        Parameters
        ----------
        state : S
            State after the last block.
        steps : list of (int, Step)
            Steps that the stages before this one released at the gap or the end.

        Returns
        -------
        state : S
            New state.
        steps : list of (int, Step)
            Steps as this stage changes them. None may wait any longer.
        """
        ...
