"""Interface of a step detector."""

from __future__ import annotations

from typing import Protocol, TypeVar

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.values import Step

S = TypeVar("S")


class StepDetector(Protocol[S]):
    """Interface of a causal stage that detects steps in uniform samples.

    `config.with_steps` uses such a detector, and `pdr_filter.testing.verify_stage` tests it. A frozen dataclass is
    recommended: it holds the constant parameters, and the state holds everything that changes. The result must not
    depend on how samples are cut into blocks. Samples are numbered from 0 after each gap.

    The state must consist of arrays, numbers, strings, None, tuples and dictionaries, or be a dataclass of such values,
    so that a filter can be saved. Classes outside of pdr_filter are saved by name, and only those in the state of
    `init` are loaded. A field of a dataclass that is None or empty there needs a declared type that names the class,
    such as `Bout | None` or `tuple[Bout, ...]`. `config.with_steps` warns if the first state cannot be saved.

    The class `pdr_filter.sensing.steps.step_log.StepLog` computes the `Step` that a contact ends. A
    detector class with `uses_contexts = False` ignores the contexts, so that `pdr_filter.detect_steps` computes none.

    Examples
    --------
    A detector of one step each half second:

    >>> from dataclasses import dataclass
    >>> from pdr_filter.sensing.steps.step_log import StepLog
    >>> @dataclass(frozen=True)
    ... class Metronome:
    ...     rate_hz: float = 100.0
    ...     latency_s: float = 0.01
    ...     first_step_s: float = 0.5
    ...     @property
    ...     def log(self):
    ...         return StepLog(self.rate_hz, self.latency_s)
    ...     def init(self):
    ...         return self.log.init()
    ...     def update(self, state, block, attitude, contexts):
    ...         first = state.n_samples
    ...         state, steps = self.log.extend(state, block, attitude), []
    ...         for contact in range(-(-first // 50) * 50, state.n_samples, 50):
    ...             if self.log.can_end(state, contact):
    ...                 state, step = self.log.add(state, contact, known=contact)
    ...                 steps.append((contact, step))
    ...         return self.log.trim(state), steps
    ...     def finish(self, state):
    ...         return []
    >>> import pdr_filter as pdr
    >>> config = pdr.recipes.default().with_steps(Metronome())
    """

    @property
    def rate_hz(self) -> float:
        """Sampling rate of the blocks, Hz. All stages must have the same rate, which is 100 in the default recipe."""
        ...

    @property
    def latency_s(self) -> float:
        """Longest time from a contact to its detection, s."""
        ...

    @property
    def first_step_s(self) -> float:
        """Duration assigned to the first step of a bout, s."""
        ...

    def init(self) -> S:
        """Return the state before the first sample and after each gap.

        Returns
        -------
        S
            Initial state.
        """
        ...

    def update(
        self, state: S, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[S, list[tuple[int, Step]]]:
        """Return the new state and the steps that a block reveals.

        Parameters
        ----------
        state : S
            State after the previous block.
        block : UniformBlock
            N uniform samples: `time_s` (N,) in s; `specific_force_mps2`, `angular_rate_radps` and `magnetic_field_ut`,
            each (N, 3).
        attitude : AttitudeBlock
            Attitude at these samples, such as `vertical_mps2` (N,) and `device_heading_rad` (N,), clockwise.
        contexts : ContextBlock
            Most probable context and carrying mode at each sample.

        Returns
        -------
        state : S
            New state.
        steps : list of (int, Step)
            Steps that became known, each with the number of the sample that revealed it.
        """
        ...

    def finish(self, state: S) -> list[tuple[int, Step]]:
        """Return the steps that still wait for samples when a gap or the end comes.

        Parameters
        ----------
        state : S
            State after the last block of a segment.

        Returns
        -------
        list of (int, Step)
            Remaining steps, each with the number of the last sample.
        """
        ...
