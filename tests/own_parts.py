"""Parts as users write them: a step detector, a heading stage, step-length models, and a configuration of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import pdr_filter as pdr
from pdr_filter.sensing.steps.step_log import StepLog, StepLogState
from pdr_filter.values import FloatArray


@dataclass(frozen=True, eq=False)
class CrossingState:
    log: StepLogState
    low: float  # smoothed vertical force
    was_up: bool


@dataclass(frozen=True)
class Crossings:
    """A step wherever the smoothed vertical force rises through zero."""

    rate_hz: float = 100.0
    first_step_s: float = 0.6
    latency_s: float = 0.02

    @property
    def _log(self) -> StepLog:
        return StepLog(self.rate_hz, self.latency_s, 2.0, self.first_step_s)

    def init(self) -> CrossingState:
        return CrossingState(self._log.init(), 0.0, was_up=True)

    def update(self, state: CrossingState, block: Any, attitude: Any, contexts: Any) -> tuple[CrossingState, list[Any]]:
        first, log, steps = state.log.n_samples, self._log.extend(state.log, block, attitude), []
        low, was_up = state.low, state.was_up
        for k, vertical in enumerate(attitude.vertical_mps2.tolist()):
            low += 0.08 * (vertical - low)
            far_s = self._log.time_s(log, first + k) - log.last_contact_s
            if low > 0.3 and not was_up and far_s > 0.3 and self._log.can_end(log, first + k):
                log, step = self._log.add(log, first + k, first + k)
                steps.append((first + k, step))
            was_up = low > 0.3 or (was_up and low > 0.0)
        return CrossingState(self._log.trim(log), low, was_up), steps

    def finish(self, state: CrossingState) -> list[Any]:
        return []


class DeviceHeading:
    """The person walks where the phone points, within 20 degrees; its state is the number of steps."""

    def init(self) -> dict[str, int]:
        return {"n_steps": 0}

    def after_gap(self, state: dict[str, int]) -> dict[str, int]:
        return state

    def update(
        self, state: dict[str, int], block: Any, attitude: Any, contexts: Any, steps: Sequence[tuple[int, pdr.Step]]
    ) -> tuple[dict[str, int], list[tuple[int, pdr.Step]]]:
        return {"n_steps": state["n_steps"] + len(steps)}, [(n, self._directed(step)) for n, step in steps]

    def finish(self, state: Any, steps: Sequence[tuple[int, pdr.Step]]) -> tuple[Any, list[tuple[int, pdr.Step]]]:
        return state, [(n, self._directed(step)) for n, step in steps]

    @staticmethod
    def _directed(step: pdr.Step) -> pdr.Step:
        return replace(step, walking_heading_rad=step.device_heading_rad, walking_heading_std_rad=0.35)


@dataclass(frozen=True)
class HeadingRule:
    """The direction of the last step that differs by more than 10 degrees from the phone; the phone's at first."""

    knows_north = True

    def init(self) -> dict[str, float]:
        return {"held": np.nan}

    def after_gap(self, state: dict[str, float]) -> dict[str, float]:
        return state

    def update(
        self, state: dict[str, float], block: Any, attitude: Any, contexts: Any, steps: Sequence[tuple[int, pdr.Step]]
    ) -> tuple[dict[str, float], list[tuple[int, pdr.Step]]]:
        return self.finish(state, steps)

    def finish(
        self, state: dict[str, float], steps: Sequence[tuple[int, pdr.Step]]
    ) -> tuple[dict[str, float], list[tuple[int, pdr.Step]]]:
        held, found = state["held"], []
        for number, step in steps:
            held = held if abs(step.device_heading_rad - held) < 0.17 else step.device_heading_rad
            found.append((number, replace(step, walking_heading_rad=held, walking_heading_std_rad=0.0)))
        return {"held": held}, found


@dataclass  # neither frozen nor hashable, as people write them
class RootOfRange:
    n_params: int = 2

    def regressors(self, step: pdr.Step) -> list[float]:
        return [1.0, max(step.vertical_range_mps2, 0.0) ** 0.25]


class Exponential:
    n_params = 1

    def length_m(self, step: pdr.Step, theta: FloatArray) -> FloatArray:
        return np.exp(theta[..., 0]) * step.frequency_hz**0.5

    def jacobian(self, step: pdr.Step, theta: FloatArray) -> FloatArray:
        return self.length_m(step, theta)[..., None]


FIT = pdr.StepLengthFit(RootOfRange(), np.array([0.1, 0.35]), np.diag([0.02, 0.02]) ** 2, 0.06)


def own_config() -> pdr.Config:
    config = pdr.recipes.default().with_steps(Crossings()).with_heading(DeviceHeading())
    return config.with_step_length("walking", FIT)
