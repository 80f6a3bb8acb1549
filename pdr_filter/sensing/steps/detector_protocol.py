"""The interface of a step detector: samples in, steps out."""

from __future__ import annotations

from typing import Protocol, TypeVar

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.values import Step

S = TypeVar("S")


class StepDetector(Protocol[S]):
    """A causal stage that finds steps; `config.with_steps` takes one, and `pdr_filter.testing.check_stage` tests it.

    A frozen dataclass is best: it holds what never changes, and the state all that does. The state must be made of
    arrays, numbers, strings, None, tuples and dictionaries, or be a dataclass of such values, so that a filter can be
    saved. The result must not depend on how samples are cut into blocks. Samples are numbered from 0 after each gap.
    `pdr_filter.sensing.steps.step_log.StepLog` describes the step that a contact ends.

    A detector whose class has `uses_contexts = False` ignores the contexts of `update`; `pdr_filter.detect_steps` then
    computes none.
    """

    @property
    def rate_hz(self) -> float:
        """Sampling rate of the blocks, Hz: 100, that of all stages of the default recipe."""
        ...

    @property
    def latency_s(self) -> float:
        """Longest time from a contact to its detection, s."""
        ...

    @property
    def first_step_s(self) -> float:
        """Duration given to the first step of a bout, s."""
        ...

    def init(self) -> S:
        """State before the first sample, and after each gap."""
        ...

    def update(
        self, state: S, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[S, list[tuple[int, Step]]]:
        """New state and the steps that became known, each with the number of the sample that revealed it.

        A block has N samples: `time_s` (N,) in s, `specific_force_mps2`, `angular_rate_radps` and `magnetic_field_ut`
        (N, 3). The attitude has `vertical_mps2` (N,), `device_heading_rad` (N,) clockwise, and more. `contexts` has the
        most probable context and carrying mode at each sample.
        """
        ...

    def finish(self, state: S) -> list[tuple[int, Step]]:
        """Steps whose detection would have needed more samples, when a gap or the end comes."""
        ...
