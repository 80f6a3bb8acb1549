"""Interface of a tracker, which turns steps, context windows, gaps and fixes into track rows."""

from __future__ import annotations

from dataclasses import Field
from typing import Any, ClassVar, Protocol, TypeVar

from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import PedestrianState, StepUpdate
from pdr_filter.values import Fix, FixOutcome, Step, WindowContext


class TrackerState(Protocol):
    """Protocol of the state of a tracker, a frozen dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]  # required by `dataclasses.replace`

    @property
    def pedestrian(self) -> PedestrianState:
        """Estimates after the last gap, fix or final step."""
        ...


S = TypeVar("S", bound=TrackerState)


class TrackerEvents(Protocol[S]):
    """One pure function for each kind of event, from the state before it to the state after it."""

    def init(self) -> S:
        """Return the state at the origin, before the first event.

        Returns
        -------
        S
            State with an initial estimate for each filter.
        """
        ...

    def on_window(self, state: S, window: WindowContext) -> tuple[S, tuple[StepUpdate, ...]]:
        """Return the state after a context window.

        Parameters
        ----------
        state : S
            State before the event.
        window : WindowContext
            Context probabilities of a window.

        Returns
        -------
        state : S
            State after the window.
        updates : tuple of StepUpdate
            Steps that this window made final.
        """
        ...

    def on_step(self, state: S, step: Step) -> tuple[S, tuple[StepUpdate, ...]]:
        """Return the state after a step, and the track rows that it produces.

        Parameters
        ----------
        state : S
            State before the event.
        step : Step
            Detected step.

        Returns
        -------
        state : S
            State after the step.
        updates : tuple of StepUpdate
            Steps that became final.
        """
        ...

    def provisional(self, state: S) -> StepUpdate | None:
        """Return a provisional update of the last step, or None if no step waits to become final.

        Parameters
        ----------
        state : S
            State after any event.

        Returns
        -------
        StepUpdate or None
            Estimate from the events so far, with `is_final` False.
        """
        ...

    def on_gap(self, state: S, gap_s: float) -> tuple[S, tuple[StepUpdate, ...]]:
        """Return the state after a gap, a time without samples.

        Parameters
        ----------
        state : S
            State before the event.
        gap_s : float
            Duration of the gap in s.

        Returns
        -------
        state : S
            State after the gap: positions and headings are less certain, and earlier windows are discarded.
        updates : tuple of StepUpdate
            Steps that the gap made final.
        """
        ...

    def on_fix(self, state: S, fix: Fix) -> tuple[S, FixOutcome, float]:
        """Return the state after a fix, and how the fix was used.

        Parameters
        ----------
        state : S
            State before the event.
        fix : Fix
            Measurement of position, heading, speed, range or standstill.

        Returns
        -------
        state : S
            State after the fix.
        outcome : FixOutcome
            How the fix was used, such as "used" or "rejected".
        nis : float
            Normalised innovation squared of the fix, or NaN if it was not compared with the track.
        """
        ...

    def finish(self, state: S) -> tuple[S, tuple[StepUpdate, ...]]:
        """Return the state after the last event.

        Parameters
        ----------
        state : S
            State before the event.

        Returns
        -------
        state : S
            State without pending steps.
        updates : tuple of StepUpdate
            Steps that became final because no window follows.
        """
        ...


class Tracker(TrackerEvents[S], Protocol[S]):
    """Protocol of a tracker: a frozen dataclass with one pure function for each kind of event (`TrackerEvents`).

    The type variable S is the class of its states. `ImmTracker` and `WeightedTracker` fulfil the protocol.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP
    >>> tracker = pdr.recipes.default().tracker
    >>> state, updates = tracker.on_step(tracker.init(), TYPICAL_STEP)
    >>> updates[0].index, updates[0].is_final
    (0, True)
    """

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]  # required by `dataclasses.replace`

    @property
    def model(self) -> PedestrianModel:
        """Modes, transitions, noise and evidence of the filters."""
        ...

    @property
    def weighting(self) -> str:
        """Short name of the weighting, such as "imm" (interacting multiple model), "wc" or "hc" (`WeightedTracker`)."""
        ...

    @property
    def waits_for_windows(self) -> int:
        """Number of windows that must follow before a step is final."""
        ...
