"""What one person is known for: the length of a typical step, learnt from fixes and carried from walk to walk."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from pdr_filter.filter.imm.estimates import Estimates
from pdr_filter.filter.imm.motion_model import LOG_SCALE, Mode
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.step_length.models import RECORDING_STD, TYPICAL_STEP, StepLengthFit, length_and_jacobian
from pdr_filter.values import check_numbers, check_whole, limits

# Fixes that leave nine tenths of the variance have said nothing.
_LEARNT = 0.9


@dataclass(frozen=True, slots=True)
class Session:
    """What the fixes of one walk said of the person's steps, without what was known before."""

    step_length_m: float  # of `models.TYPICAL_STEP`
    std: float  # relative, of this walk's own scale
    n_fixes: int  # positions and speeds that were used

    def __post_init__(self) -> None:
        check_numbers(self, zero=("n_fixes",))


@dataclass(frozen=True, slots=True)
class Person:
    """The length of one person's typical step, from the fixes of some walks; `Track.person` has it.

    Given to the next recording of the same person (`pdr_filter.track(..., person=...)`), whose lengths are then that
    person's from the first step on, whatever height or recipe it has. A typical step is one of level walking at 1.85
    steps a second. Walks are weighted by what their fixes knew; the same walk counts once, however often it is pooled,
    and what is known of people in general is in none of them.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.filter.step_length.person import Session
    >>> person = pdr.Person((Session(0.71, 0.02, 40),)).pooled(pdr.Person((Session(0.75, 0.02, 35),)))
    >>> round(person.step_length_m, 2)
    0.73
    >>> _ = person.save("me.json")
    >>> pdr.Person.load("me.json") == person
    True
    """

    sessions: tuple[Session, ...] = ()

    @property
    def n_fixes(self) -> int:
        """Positions and speeds of all walks."""
        return sum(session.n_fixes for session in self.sessions)

    @property
    def step_length_m(self) -> float:
        """Of a typical step; NaN if nothing is known."""
        log_length, precision = self._pooled()
        return math.exp(log_length) if precision > 0 else math.nan

    @property
    def std(self) -> float:
        """Relative standard deviation of `step_length_m`, infinite if nothing is known."""
        precision = self._pooled()[1]
        return precision**-0.5 if precision > 0 else math.inf

    def pooled(self, other: Person) -> Person:
        """With the walks of another one that is the same person."""
        return Person((*self.sessions, *(s for s in other.sessions if s not in self.sessions)))

    def save(self, path: str | Path) -> Path:
        """Write it as JSON and return the path."""
        # Only when called: the filter opens no files.
        from pdr_filter.io.files.safe_files import write_text

        content = {"pdr_filter_person": 1, "sessions": [asdict(session) for session in self.sessions]}
        return write_text(path, json.dumps(content, indent=1) + "\n")

    @classmethod
    def load(cls, path: str | Path) -> Person:
        """Read what `save` wrote; ValueError that names the file if it is none."""
        from pdr_filter.io.files.safe_files import read_json

        try:
            content = read_json(Path(path), limits.MAX_SMALL_BYTES)
            if content["pdr_filter_person"] != 1:
                raise ValueError(f"version {content['pdr_filter_person']}")
            sessions = tuple(Session(**session) for session in content["sessions"])
            for session in sessions:
                check_whole(session)
            return cls(sessions)
        except Exception as error:  # whatever a damaged file provokes
            raise ValueError(f"{path}: no person file of pdr_filter ({error}); write one with Person.save") from None

    def in_model(self, model: PedestrianModel) -> PedestrianModel:
        """The model with the step lengths of this person, and how sure they are.

        What the model says of people in general is one measurement more. One walk differs from the next by
        `RECORDING_STD`.
        """
        log_length, precision = self._pooled()
        usual = math.log(_typical_length_m(model))
        prior = model.noise.log_scale_std**-2 if model.noise.log_scale_std > 0 else math.inf
        if precision == 0 or math.isinf(prior):
            return model
        factor = math.exp((log_length - usual) * precision / (precision + prior))
        std = math.sqrt(1.0 / (precision + prior) + RECORDING_STD**2)
        modes = tuple(replace(mode, step_length=_scaled(mode.step_length, factor)) for mode in model.modes)
        return replace(model, modes=modes, noise=replace(model.noise, log_scale_std=std))

    def _pooled(self) -> tuple[float, float]:
        """Mean of the log length and its precision: walks of one person differ, however well each is known."""
        if not self.sessions:
            return 0.0, 0.0
        weights = np.array([1.0 / (s.std**2 + RECORDING_STD**2) for s in self.sessions])
        logs = np.log([s.step_length_m for s in self.sessions])
        return float(weights @ logs / weights.sum()), float(weights.sum())


def session_of(model: PedestrianModel, estimates: Estimates, n_fixes: int) -> Session | None:
    """Return the step length (m) estimated from the fixes of a walk, or None if they do not determine it."""
    x, P = estimates.combined
    return session_of_scale(model, float(x[LOG_SCALE]), float(P[LOG_SCALE, LOG_SCALE]), n_fixes)


def session_of_scale(model: PedestrianModel, log_scale: float, var: float, n_fixes: int) -> Session | None:
    """Return the step length that belongs to an estimated log scale, or None if the prior knew as much.

    The posterior N(m, v) of the log scale less its prior N(0, s^2): precision w = 1 / v - 1 / s^2, mean (m / v) / w.
    """
    prior_var = model.noise.log_scale_std**2
    if not 0 < var < _LEARNT * prior_var:
        return None
    w = 1.0 / var - 1.0 / prior_var
    return Session(_typical_length_m(model) * math.exp(log_scale / var / w), w**-0.5, n_fixes)


def _typical_length_m(model: PedestrianModel) -> float:
    fit = _main_mode(model.modes).step_length
    return float(length_and_jacobian(fit.model, TYPICAL_STEP, fit.theta)[0])


def _main_mode(modes: Sequence[Mode]) -> Mode:
    """The mode of level walking; else the first that moves."""
    return next((m for m in modes if m.meaning.is_level_walking), next((m for m in modes if m.moves), modes[0]))


def _scaled(fit: StepLengthFit, factor: float) -> StepLengthFit:
    if not hasattr(fit.model, "regressors"):
        raise ValueError(
            "a person's step length is for models that are linear in their parameters, got "
            f'{type(fit.model).__name__}: use recipe "default"'
        )
    return replace(fit, theta=factor * fit.theta, theta_cov=factor**2 * fit.theta_cov)
