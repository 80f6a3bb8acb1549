"""Results of a step-length calibration: parameters of a population and of its persons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, is_dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from pdr_filter.filter.step_length.models import TYPICAL_STEP, StepLengthFit, StepLengthModel, length_and_jacobian
from pdr_filter.values import (
    FloatArray,
    Table,
    TrackRows,
    check_array,
    check_columns,
    check_cov,
    check_name_of_context,
    check_step_length,
    read_only,
    reduction,
)
from pdr_filter.values.limits import HEIGHT_RANGE_M
from pdr_filter.values.recording import Subject

ARRAYS = ("theta", "theta_cov", "between_cov", "people", "people_cov", "heights_m")
_TEXTS, _FLAGS = ("subject", "recording", "context"), ("summed", "distrusted")
_LENGTHS = ("distance_m", "predicted_m", "left_out_m", "stranger_m", "uncalibrated_m")
_COLUMN_KINDS = {
    **dict.fromkeys(_TEXTS, "U"),
    **dict.fromkeys(_FLAGS, "b"),
    **dict.fromkeys(("start_s", "end_s", "n_steps", "misfit", "weight", *_LENGTHS), "if"),
}
_LARGEST_STD = 1e3  # larger standard deviations (m, or relative) are rejected as nonsense
# Person of recordings without a name, because users who calibrate their own steps rarely enter a name.
UNNAMED = "unnamed"
# Maximum difference of the heights that two recordings of the same person state.
_SAME_HEIGHT_M = 0.02


def _std(cov: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    return {name: np.sqrt(np.diagonal(matrix)) for name, matrix in cov.items()}


@dataclass(frozen=True, eq=False)
class CalibratedPerson:
    """Calibrated step-length parameters of one person.

    Attributes
    ----------
    id : str
        Name of the person.
    height_m : float or None
        Height of the person, which the step-length models use with the parameters.
    k : mapping of str to ndarray of shape (p,)
        Parameters of each context. Contexts without segments have the parameters of the population.
    k_cov : mapping of str to ndarray of shape (p, p)
        Covariance of the parameters. Contexts without segments have the covariance between persons.
    n_segments : int
        Number of segments of the person.
    main_context : str
        Main context of the calibration.
    """

    id: str
    height_m: float | None
    k: Mapping[str, FloatArray]
    k_cov: Mapping[str, FloatArray]
    n_segments: int
    main_context: str = "walking"

    @property
    def k0(self) -> float:
        """First parameter of the step-length model of the `main_context` of the calibration."""
        return float(self.k[self.main_context][0])

    @property
    def k_std(self) -> dict[str, FloatArray]:
        """Standard deviation (p,) of the parameters of each context."""
        return _std(self.k_cov)


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult:
    """Step-length parameters of a population and of its persons. `pdr_filter.Calibration` describes the fields."""

    models: Mapping[str, StepLengthModel]
    theta: FloatArray
    theta_cov: FloatArray
    between_cov: FloatArray
    people: FloatArray
    people_cov: FloatArray
    subject_ids: tuple[str, ...]
    heights_m: FloatArray
    residual_std_m: Mapping[str, float]
    recording_std: float
    n_segments: Mapping[str, float]
    segments: Table
    notes: tuple[str, ...] = ()
    card: Mapping[str, Any] | None = None
    mode_contexts: Mapping[str, str] = field(default_factory=dict[str, str])
    tracks: tuple[TrackRows, ...] = ()

    __reduce__ = reduction

    def __post_init__(self) -> None:
        for name in ARRAYS:
            object.__setattr__(self, name, read_only(getattr(self, name), name))
        n, s = slices_of(self.models)[1], len(self.subject_ids)
        shapes = (n,), (n, n), (n, n), (s, n), (s, n, n), (s,)
        for name, shape in zip(ARRAYS, shapes, strict=True):
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} must be {shape}, got {getattr(self, name).shape}")
        for name in self.models:
            check_name_of_context(name)
        check_columns(self.segments, _COLUMN_KINDS, "segments")
        _check_numbers(self)

    @property
    def contexts(self) -> tuple[str, ...]:
        """Calibrated contexts, which are the main context of at least one segment that was not rejected.

        A context with only a few uncertain steps in segments of other contexts is not calibrated. A context whose step
        length is held at zero, such as standing, is left out.
        """
        of = self.mode_contexts
        found = {of.get(c, c) for c in self.segments.context[~self.segments.distrusted].tolist()}
        k, k_cov = self.k, self.k_cov
        return tuple(c for c in self.models if of.get(c, c) in found and (k[c].any() or k_cov[c].any()))

    @property
    def main_context(self) -> str:
        """The context "walking" if it was calibrated, else the first calibrated context.

        If no context was calibrated, it is "walking" or else the first context of `models`.
        """
        names = self.contexts or tuple(self.models)
        return "walking" if "walking" in names or not names else names[0]

    @property
    def k(self) -> dict[str, FloatArray]:
        """Parameters (p,) of the population in each context."""
        return self._by_context(self.theta)

    @property
    def k_cov(self) -> dict[str, FloatArray]:
        """Covariance (p, p) of the estimated parameters of the population in each context."""
        return self._blocks(self.theta_cov)

    @property
    def k_std(self) -> dict[str, FloatArray]:
        """Standard deviation (p,) of the estimated parameters of the population in each context."""
        return _std(self.k_cov)

    @property
    def between(self) -> dict[str, FloatArray]:
        """Covariance (p, p) of the parameters between persons in each context."""
        return self._blocks(self.between_cov)

    @property
    def subjects(self) -> dict[str, CalibratedPerson]:
        """Calibrated persons by name, with personal `k` and `k_std`. Those of the calibration are of the population."""
        return {
            name: CalibratedPerson(
                name,
                None if np.isnan(self.heights_m[s]) else float(self.heights_m[s]),
                self._by_context(self.people[s]),
                self._blocks(self.people_cov[s]),
                int(np.sum(self.segments.subject == name)),
                self.main_context,
            )
            for s, name in enumerate(self.subject_ids)
        }

    @property
    def distrusted(self) -> Table:
        """Segments that were rejected because their residual exceeds three standard deviations."""
        return self.segments[self.segments.distrusted].view(np.recarray)

    def person_of(self, subject: Subject | str | None = None) -> str | None:
        """Return the name of the calibrated person whose parameters apply to a subject.

        A subject without a name is assumed to be the only person of the calibration, or the person who was calibrated
        without a name, unless both heights are known and differ.

        Parameters
        ----------
        subject : Subject or str, optional
            Subject of a recording, or a name.

        Returns
        -------
        str or None
            Name in `subject_ids`, or None if the parameters of the population apply.
        """
        subject = Subject(id=subject) if isinstance(subject, str) else subject or Subject()
        names = self.subject_ids
        if subject.id is not None:
            return subject.id if subject.id in names else None
        name = names[0] if len(names) == 1 else UNNAMED
        if name not in names:
            return None
        apart_m = self.heights_m[names.index(name)] - (np.nan if subject.height_m is None else subject.height_m)
        return None if abs(apart_m) > _SAME_HEIGHT_M else name

    def fits(self, subject: Subject | str | None = None) -> dict[str, StepLengthFit]:
        """Return the step-length models of all contexts with parameters and covariance for a person.

        Parameters
        ----------
        subject : Subject or str, optional
            Subject of a recording, or a name; `person_of` selects the calibrated person.

        Returns
        -------
        dict of str to StepLengthFit
            Step-length fit of each context. A subject who was not calibrated gets the parameters of the population. The
            covariance then excludes the differences between persons, which are a common factor of all steps of a
            person and are included in `scale_std`.
        """
        name = self.person_of(subject)
        theta, cov = self.theta, self.theta_cov
        height_m = subject.height_m if isinstance(subject, Subject) else None
        if name is not None:
            s = self.subject_ids.index(name)
            theta, cov = self.people[s], self.people_cov[s]
            height_m = None if np.isnan(self.heights_m[s]) else float(self.heights_m[s])
        k, k_cov = self._by_context(theta), self._blocks(cov)
        return {
            name: StepLengthFit(of_height(model, height_m), k[name], k_cov[name], self.residual_std_m[name])
            for name, model in self.models.items()
        }

    def scale_std(self, subject: Subject | str | None = None) -> float:
        """Return the relative standard deviation of the common scale of all step lengths of a person.

        It combines the uncertainty of the parameters in `main_context` with the variation between recordings of one
        person. For a subject who was not calibrated it includes the variation between persons.

        Parameters
        ----------
        subject : Subject or str, optional
            Subject of a recording, or a name; `person_of` selects the calibrated person.

        Returns
        -------
        float
            Relative standard deviation.
        """
        context = self.main_context
        fit = self.fits(subject)[context]
        cov = fit.theta_cov + self.between[context] if self.person_of(subject) is None else fit.theta_cov
        length_m, std_m = typical_step_m(fit.model, fit.theta, cov)
        relative = std_m / max(length_m, 1e-3)
        return float(np.hypot(min(relative, 1.0), self.recording_std))

    def _by_context(self, theta: FloatArray) -> dict[str, FloatArray]:
        return {name: theta[part] for name, part in slices_of(self.models)[0].items()}

    def _blocks(self, cov: FloatArray) -> dict[str, FloatArray]:
        return {name: cov[part, part] for name, part in slices_of(self.models)[0].items()}


def _check_numbers(calibration: CalibrationResult) -> None:
    """Raise ValueError for numbers that the filter cannot use. Only `between_cov` may be infinite."""
    for name in ("theta", "people"):
        check_array(name, getattr(calibration, name))
    for name in ("theta_cov", "people_cov"):
        cov = getattr(calibration, name)
        check_cov(cov, name)
        for part in slices_of(calibration.models)[0].values():  # each is used alone, with a tolerance of its own
            for of_context in cov.reshape(-1, *cov.shape[-2:])[:, part, part]:
                check_cov(of_context, name)
    if not (np.diagonal(calibration.between_cov) >= 0).all():
        raise ValueError(
            "between_cov must have variances, 0 or more, on its diagonal, got "
            f"{np.diagonal(calibration.between_cov)}: use the covariance that pdr_filter.calibrate returns"
        )
    heights_m, (least_m, largest_m) = calibration.heights_m, HEIGHT_RANGE_M
    if ((heights_m < least_m) | (heights_m > largest_m)).any():
        raise ValueError(f"heights_m must be {least_m} to {largest_m}, NaN where unknown, got {heights_m}")
    for name in ("residual_std_m", "n_segments"):
        if not set(calibration.models) <= set(getattr(calibration, name)):
            raise ValueError(f"{name} must have a value for each context of models, {tuple(calibration.models)}")
    known = {**calibration.residual_std_m, "recording_std": calibration.recording_std}
    if not all(0 <= std <= _LARGEST_STD for std in known.values()):
        raise ValueError(f"residual_std_m and recording_std must be from 0 to {_LARGEST_STD}, got {known}")
    if "walking" in calibration.contexts:
        for theta in (calibration.theta, *calibration.people):
            k = theta[slices_of(calibration.models)[0]["walking"]]
            length_m, _ = typical_step_m(calibration.models["walking"], k, np.zeros((len(k), len(k))))
            if not np.isnan(length_m):
                check_step_length("the typical step length of walking", length_m)
    if calibration.main_context not in calibration.models:
        raise ValueError("models must contain the model of at least one context, got none")


def slices_of(models: Mapping[str, StepLengthModel]) -> tuple[dict[str, slice], int]:
    """Return the slice of each context in the parameter vector theta (P,) of all contexts, and its length P."""
    ends = np.cumsum([0, *(m.n_params for m in models.values())])
    return {name: slice(int(a), int(b)) for name, (a, b) in zip(models, pairwise(ends), strict=True)}, int(ends[-1])


def of_height(model: StepLengthModel, height_m: float | None) -> StepLengthModel:
    """Return the model for a person of this height, or the model itself if it has no height or none is known."""
    if height_m is None or not hasattr(model, "height_m") or not is_dataclass(model):
        return model
    return replace(model, height_m=float(height_m))  # pyright: ignore[reportArgumentType, reportCallIssue, reportUnknownVariableType, reportGeneralTypeIssues, reportTypeVar]


def typical_step_m(model: StepLengthModel, theta: FloatArray, cov: FloatArray) -> tuple[float, float]:
    """Return the length of a typical step and its standard deviation given the covariance of theta, both in m."""
    length, jacobian = length_and_jacobian(model, TYPICAL_STEP, theta)
    return float(length), float(np.sqrt(jacobian @ cov @ jacobian))
