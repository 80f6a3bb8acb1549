"""Step length of one person, learnt from fixes and carried between recordings."""

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

# If more than this share of the prior variance is left, the fixes have added no usable information.
_MAX_VAR_SHARE = 0.9


@dataclass(frozen=True, slots=True)
class Session:
    """Step length of a person as measured by the fixes of one walk, without the prior of the filter.

    Attributes
    ----------
    step_length_m : float
        Length in m of a typical step (`models.TYPICAL_STEP`: level walking at 1.85 steps a second).
    std : float
        Relative standard deviation of `step_length_m` for this walk. The variation between walks of one person is not
        in it.
    n_fixes : int
        Number of position and speed fixes that were used.

    Raises
    ------
    ValueError
        If a field is not a positive number (`n_fixes` may be 0).

    Examples
    --------
    >>> from pdr_filter.filter.step_length.person import Session
    >>> Session(step_length_m=0.71, std=0.02, n_fixes=40)
    Session(step_length_m=0.71, std=0.02, n_fixes=40)
    """

    step_length_m: float
    std: float
    n_fixes: int

    def __post_init__(self) -> None:
        check_numbers(self, zero=("n_fixes",))


@dataclass(frozen=True, slots=True)
class Person:
    """Step length of one person, pooled over walks with fixes.

    `Track.person` returns the person of a track. Pass it to the next recording of the same person
    (`pdr_filter.track(..., person=...)`). The step lengths of that track then start near the step lengths of the
    person, for any body height. They are the step lengths of the walks, combined with the prior of the recipe. A
    step-length model that does not estimate the scale is not changed. ValueError for a model that is not linear in its
    parameters, as of guo2018.

    Attributes
    ----------
    sessions : tuple of Session, default ()
        One entry for each walk. An equal entry counts once, however often it is pooled.

    Notes
    -----
    The step length is the length of a typical step: level walking at 1.85 steps a second. A length, unlike a factor,
    has the same meaning under any height, recipe or calibration. Walks are weighted by the precision of their
    estimates. No session contains the prior knowledge about people in general, which is therefore never counted twice.

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
        """Number of position and speed fixes that were used in all walks."""
        return sum(session.n_fixes for session in self.sessions)

    @property
    def step_length_m(self) -> float:
        """Length in m of a typical step, or NaN without walks."""
        log_length, precision = self._pooled()
        return math.exp(log_length) if precision > 0 else math.nan

    @property
    def std(self) -> float:
        """Relative standard deviation of `step_length_m`, or infinity without walks."""
        precision = self._pooled()[1]
        return precision**-0.5 if precision > 0 else math.inf

    def pooled(self, other: Person) -> Person:
        """Return the person with the walks of both objects.

        Parameters
        ----------
        other : Person
            Further walks of the same person. Sessions that both objects contain count once.

        Returns
        -------
        Person
            Person with the sessions of both.
        """
        return Person((*self.sessions, *(s for s in other.sessions if s not in self.sessions)))

    def save(self, path: str | Path) -> Path:
        """Write the person to a JSON file.

        Parameters
        ----------
        path : str or Path
            File to write. An existing file is replaced.

        Returns
        -------
        Path
            Path of the written file.
        """
        # Imported here because the filter package must not depend on file access.
        from pdr_filter.io.files.safe_files import write_text

        content = {"pdr_filter_person": 1, "sessions": [asdict(session) for session in self.sessions]}
        return write_text(path, json.dumps(content, indent=1) + "\n")

    @classmethod
    def load(cls, path: str | Path) -> Person:
        """Return the person that `save` wrote to a file.

        Parameters
        ----------
        path : str or Path
            JSON file written by `Person.save`.

        Returns
        -------
        Person
            Person of the file.

        Raises
        ------
        ValueError
            If the file cannot be read or is not a person file.
        """
        from pdr_filter.io.files.safe_files import read_json

        try:
            content = read_json(Path(path), limits.MAX_SMALL_BYTES)
            if content["pdr_filter_person"] != 1:
                raise ValueError(f"it has format version {content['pdr_filter_person']} instead of 1")
            sessions = tuple(Session(**session) for session in content["sessions"])
            for session in sessions:
                check_whole(session)
            return cls(sessions)
        except Exception as error:  # a damaged file can raise any error
            raise ValueError(f"{path}: not a person file of pdr_filter ({error}); write one with Person.save") from None

    def in_model(self, model: PedestrianModel) -> PedestrianModel:
        """Return a filter model with the step lengths of this person.

        The step lengths of all modes are multiplied by one factor. The prior of the model about people in general is
        combined with the walks as one more measurement. The variation between walks of one person is added (2.5 %).

        Parameters
        ----------
        model : PedestrianModel
            Modes and noise of a filter.

        Returns
        -------
        PedestrianModel
            Model with scaled step lengths and with the standard deviation of the remaining log scale in its noise.
            Without walks, or for a model that does not estimate the scale (`log_scale_std` 0), the model is returned
            unchanged.

        Raises
        ------
        ValueError
            If a step-length model is not linear in its parameters.
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
        """Return the weighted mean of the log step lengths of all walks, and the precision of the mean.

        Both are 0 without walks. The variance of each walk includes the variation between walks of one person
        (`RECORDING_STD`), so that a single precise walk does not dominate.
        """
        if not self.sessions:
            return 0.0, 0.0
        weights = np.array([1.0 / (s.std**2 + RECORDING_STD**2) for s in self.sessions])
        logs = np.log([s.step_length_m for s in self.sessions])
        return float(weights @ logs / weights.sum()), float(weights.sum())


def session_of(model: PedestrianModel, estimates: Estimates, n_fixes: int) -> Session | None:
    """Return the step length of a walk as measured by its fixes, or None if they do not determine it.

    It follows from the log scale in the combined estimate of the filters.
    """
    x, P = estimates.combined
    return session_of_scale(model, float(x[LOG_SCALE]), float(P[LOG_SCALE, LOG_SCALE]), n_fixes)


def session_of_scale(model: PedestrianModel, log_scale: float, var: float, n_fixes: int) -> Session | None:
    """Return the step length that belongs to an estimated log scale, or None if the fixes added too little information.

    `log_scale` and `var` are mean and variance of the estimate at the end of the walk. The prior N(0, s^2) of the log
    scale is removed from its posterior N(m, v). The remaining precision is w = 1 / v - 1 / s^2, and the remaining mean
    is (m / v) / w. The fixes added too little information if v is at least 90 % of s^2.
    """
    prior_var = model.noise.log_scale_std**2
    if not 0 < var < _MAX_VAR_SHARE * prior_var:
        return None
    w = 1.0 / var - 1.0 / prior_var
    return Session(_typical_length_m(model) * math.exp(log_scale / var / w), w**-0.5, n_fixes)


def _typical_length_m(model: PedestrianModel) -> float:
    """Return the length of `TYPICAL_STEP` in the level-walking mode, in m."""
    fit = _main_mode(model.modes).step_length
    return float(length_and_jacobian(fit.model, TYPICAL_STEP, fit.theta)[0])


def _main_mode(modes: Sequence[Mode]) -> Mode:
    """Return the mode of level walking, or else the first mode that moves, or else the first mode."""
    return next((m for m in modes if m.meaning.is_level_walking), next((m for m in modes if m.moves), modes[0]))


def _scaled(fit: StepLengthFit, factor: float) -> StepLengthFit:
    """Return the fit with all lengths multiplied by a factor. ValueError for a model that is not linear."""
    if not hasattr(fit.model, "regressors"):
        raise ValueError(
            f"person cannot scale the step-length model {type(fit.model).__name__}, because it is not linear in its "
            'parameters: use recipe "default" or track without person'
        )
    return replace(fit, theta=factor * fit.theta, theta_cov=factor**2 * fit.theta_cov)
