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
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.step_length.models import (
    RECORDING_STD,
    TYPICAL_STEP,
    StepLengthFit,
    is_linear,
    length_and_jacobian,
    scale_std,
)
from pdr_filter.values import (
    Fix,
    PositionFix,
    RangeFix,
    SpeedFix,
    check_numbers,
    check_step_length,
    check_whole,
    limits,
)
from pdr_filter.values.fix_error_correlation import MAX_SHRINKAGE, SHRINKAGE_STD
from pdr_filter.values.safe_files import read_json, write_text

# Largest relative standard deviation of the step length that is learnt from a walk. Less certain walks are not
# stored. The value is that of step lengths among people of unknown height, because a less certain walk says less
# about the person than this distribution. Without the prior, it would deviate from the population more than twice as
# much as the estimate of the filter, which would amplify errors of linearisation. The limit does not depend on the
# prior of the filter, so that the same walks are learnt with and without a known person.
MAX_SESSION_STD = scale_std(None)


@dataclass(frozen=True, slots=True)
class Session:
    """Step length of a person as measured by the fixes of one walk, without the prior of the filter.

    Attributes
    ----------
    step_length_m : float
        Length in m of a typical step (`models.TYPICAL_STEP`: level walking at 1.85 steps a second).
    std : float
        Relative standard deviation of `step_length_m` for this walk, for learnt sessions at most `MAX_SESSION_STD`. The
        variation between walks of one person is not in it.
    n_fixes : int
        Number of position and speed fixes that were used.

    Raises
    ------
    ValueError
        If a field is not a positive number (`n_fixes` may be 0), or if the length is not plausible in metres.

    Examples
    --------
    >>> from pdr_filter.filter.pedestrian.person import Session
    >>> Session(step_length_m=0.71, std=0.02, n_fixes=40)
    Session(step_length_m=0.71, std=0.02, n_fixes=40)
    """

    step_length_m: float
    std: float
    n_fixes: int

    def __post_init__(self) -> None:
        check_numbers(self, zero=("n_fixes",))
        check_step_length("step_length_m", self.step_length_m)


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
    >>> from pdr_filter.filter.pedestrian.person import Session
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
        try:
            content = read_json(Path(path), limits.MAX_SMALL_BYTES)
            if content["pdr_filter_person"] != 1:
                raise ValueError(f"it has format version {content['pdr_filter_person']} instead of 1")
            sessions = tuple(Session(**session) for session in content["sessions"])
            for session in sessions:
                check_whole(session)
            return cls(sessions)
        except Exception as error:  # a damaged file can raise any error
            raise ValueError(
                f"{path}: not a person file of pdr_filter ({error}); write one with Person.save or track --person"
            ) from None

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
        prior = model.noise.log_scale_std**-2 if model.noise.log_scale_std > 0 else math.inf
        if precision == 0 or math.isinf(prior):
            return model
        usual = math.log(_typical_length_m(model))
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


@dataclass(frozen=True, slots=True)
class LengthFixes:
    """Number of the used fixes that a session is learnt from, and size of the area of the correlated ones."""

    n: int = 0  # used positions, ranges and speeds
    n_correlated: int = 0  # positions with correlated errors among them, such as the locations of a phone
    sum_m: tuple[float, float] = (0.0, 0.0)  # sum of the correlated positions, east and north
    square_m2: float = 0.0  # sum of the squared distances of the correlated positions from the origin
    var_m2: float = 0.0  # sum of the variances of the correlated positions along one axis

    def plus(self, fix: Fix) -> LengthFixes:
        """Return the sums with one more used fix. Fixes that say nothing about step lengths change nothing."""
        if not isinstance(fix, PositionFix | SpeedFix | RangeFix):
            return self
        if not isinstance(fix, PositionFix) or fix.correlation_s == 0:
            return replace(self, n=self.n + 1)
        east_m, north_m = fix.position_m.tolist()
        return LengthFixes(
            self.n + 1,
            self.n_correlated + 1,
            (self.sum_m[0] + east_m, self.sum_m[1] + north_m),
            self.square_m2 + east_m**2 + north_m**2,
            self.var_m2 + fix.var_m2,
        )

    @property
    def size_std(self) -> float:
        """Relative standard deviation of the size of the walk in the correlated fixes, an error that all share.

        A phone smooths its locations, which brings them closer to their mean (`SHRINKAGE_STD`). The error can last
        for the whole walk, and then looks like shorter steps. It is half of the distance from the mean, and at most 1.5
        standard deviations of a location. It is therefore large for a walk around a building and small for a walk over
        some hundred metres. It is 0 with fewer than two such fixes.
        """
        if self.n_correlated < 2:
            return 0.0
        mean = (self.sum_m[0] / self.n_correlated) ** 2 + (self.sum_m[1] / self.n_correlated) ** 2
        away_m2 = max(self.square_m2 / self.n_correlated - mean, 0.0)
        most_m = MAX_SHRINKAGE * math.sqrt(self.var_m2 / self.n_correlated)
        return SHRINKAGE_STD * min(1.0, most_m / max(SHRINKAGE_STD * math.sqrt(away_m2), 1e-9))


def session_of(model: PedestrianModel, estimates: Estimates, fixes: LengthFixes) -> Session | None:
    """Return the step length of a walk as measured by its fixes, or None if they do not determine it.

    It follows from the log scale in the combined estimate of the filters.
    """
    x, P = estimates.combined
    prior_var = model.noise.log_scale_std**2
    return session_of_scale(model, (float(x[LOG_SCALE]), float(P[LOG_SCALE, LOG_SCALE])), prior_var, fixes)


def session_of_scale(
    model: PedestrianModel, estimate: tuple[float, float], prior_var: float, fixes: LengthFixes
) -> Session | None:
    """Return the step length that belongs to an estimated log scale, or None if the fixes do not determine it.

    `estimate` are the mean m and variance v of the log scale at the end of the walk, and `prior_var` is the variance
    s^2 of its prior, of mean zero. The prior is removed. The remaining variance is u = v s^2 / (s^2 - v), and the
    remaining mean m u / v. The variance of the session is u plus that of the size of the walk in the fixes
    (`LengthFixes.size_std`). The result is None if its root is above `MAX_SESSION_STD`.
    """
    mean, var = estimate
    if model.noise.log_scale_std == 0 or not 0 < var < prior_var:
        return None
    own_var = var * prior_var / (prior_var - var)
    std, usual_m = math.sqrt(own_var + fixes.size_std**2), _typical_length_m(model)
    if std > MAX_SESSION_STD or not usual_m > 0:
        return None
    return Session(usual_m * math.exp(mean * own_var / var), std, fixes.n)


def _typical_length_m(model: PedestrianModel) -> float:
    """Return the length of `TYPICAL_STEP` in the level-walking mode, in m."""
    fit = _main_mode(model.modes).step_length
    return float(length_and_jacobian(fit.model, TYPICAL_STEP, fit.theta)[0])


def _main_mode(modes: Sequence[Mode]) -> Mode:
    """Return the mode of level walking, or else the first mode that moves, or else the first mode."""
    return next((m for m in modes if m.meaning.is_level_walking), next((m for m in modes if m.moves), modes[0]))


def _scaled(fit: StepLengthFit, factor: float) -> StepLengthFit:
    """Return the fit with all lengths multiplied by a factor. ValueError for a model that is not linear."""
    if not is_linear(fit.model):
        raise ValueError(
            f"person cannot scale the step-length model {type(fit.model).__name__}, because it is not linear in its "
            'parameters: use recipe "default" or track without person'
        )
    return replace(fit, theta=factor * fit.theta, theta_cov=factor**2 * fit.theta_cov)
