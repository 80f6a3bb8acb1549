"""Results of a step-length calibration: saved, loaded, and used by the filter. This module does not need gtsam."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import partial
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from pdr_filter.classifiers.model_files import Arrays, ArtefactFormat, file_pair, of_prefix, prefixed
from pdr_filter.filter.imm.motion_model import Mode
from pdr_filter.filter.pedestrian.person import Person
from pdr_filter.filter.step_length import models as step_length
from pdr_filter.filter.step_length.models import TYPICAL_STEP, StepLengthFit, StepLengthModel, length_and_jacobian
from pdr_filter.recipes.config import Config
from pdr_filter.values import (
    FloatArray,
    Note,
    Table,
    TrackRows,
    check_array,
    check_columns,
    check_cov,
    check_name_of_context,
    check_step_length,
    how_many,
    pickled,
    read_only,
    table,
)
from pdr_filter.values.limits import HEIGHT_RANGE_M
from pdr_filter.values.recording import Subject

if TYPE_CHECKING:
    from matplotlib.figure import Figure


FORMAT = ArtefactFormat("calibration", 1, "calibrate again, or use the version that wrote it")
_ARRAYS = ("theta", "theta_cov", "between_cov", "people", "people_cov", "heights_m")
_SEGMENT = "segment_"  # prefix of the column names of `segments` in a file
_TEXTS, _FLAGS = ("subject", "recording", "context"), ("summed", "distrusted")
_LENGTHS = ("distance_m", "predicted_m", "left_out_m", "stranger_m", "uncalibrated_m")
_COLUMN_KINDS = {
    **dict.fromkeys(_TEXTS, "U"),
    **dict.fromkeys(_FLAGS, "b"),
    **dict.fromkeys(("start_s", "end_s", "n_steps", "misfit", "weight", *_LENGTHS), "if"),
}
_LARGEST_STD = 1e3  # larger standard deviations (m, or relative) are rejected as nonsense
_MOST_PEOPLE, _MOST_NOTES = 20, 12  # maximum number in the report
# Person of recordings without a name, because users who calibrate their own steps rarely enter a name.
UNNAMED = "unnamed"
# Maximum difference of the heights that two recordings of the same person state.
_SAME_HEIGHT_M = 0.02


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


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """Step-length parameters of a population and of its persons, for each context.

    `pdr_filter.calibrate` returns one, and `pdr_filter.track(recording, calibration=...)` uses it. Vectors of
    parameters are the parameters of all contexts one after the other, in the order of `models`. P is their number, and
    S is the number of persons.

    Parameters
    ----------
    models : dict of str to StepLengthModel
        Step-length model of each context.
    theta : ndarray of shape (P,)
        Parameters of the population, which are used for persons who were not calibrated.
    theta_cov : ndarray of shape (P, P)
        Covariance of the estimate `theta`.
    between_cov : ndarray of shape (P, P)
        Covariance of the parameters between persons.
    people : ndarray of shape (S, P)
        Parameters of each person.
    people_cov : ndarray of shape (S, P, P)
        Covariance of the estimate `people`.
    subject_ids : tuple of str
        Names of the S persons.
    heights_m : ndarray of shape (S,)
        Heights of the persons in m, NaN if unknown.
    residual_std_m : dict of str to float
        Standard deviation of single steps about the model, in m, for each context.
    recording_std : float
        Relative standard deviation of the step scale of one person between recordings.
    n_segments : dict of str to float
        Number of segments of each context. A segment counts for several contexts by their shares of its steps.
    segments : Table
        One row for each segment, with columns `subject`, `recording`, `context`, `start_s`, `end_s`, `distance_m`
        (known), `n_steps`, `summed` (True if step lengths were summed instead of displacements), `predicted_m`
        (in-sample), `left_out_m` (predicted without this segment), `stranger_m` (predicted without this person, NaN
        if the other persons do not determine the parameters), `uncalibrated_m` (predicted by the prior), `misfit`
        (difference from the prediction of all other segments in standard deviations), `weight` (robust weight) and
        `distrusted` (rejected as an outlier).
    notes : tuple of str
        Warnings, and reports about segments that were skipped, reinterpreted or rejected.
    card : dict, optional
        Version, date and other information about the calibration.
    mode_contexts : dict of str to str, optional
        Context of each mode whose step length was calibrated separately, because other modes of its context have
        different ones. The name of the mode then stands for a context in all other fields.
    tracks : tuple of TrackRows, optional
        Smoothed tracks of the recordings of a calibration with `smooth`, as `Track`. They are not saved.

    Raises
    ------
    ValueError
        If shapes, contexts or numbers do not match.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> legs = [pdr.simulate.Leg("walking", distance_m=d, turn_rad=1.57) for d in (30.0, 20.0)]
    >>> calibration = pdr.calibrate([pdr.simulate.simulate(legs)], model="tian")
    >>> calibration
    Calibration(walking; 1 people, 2 segments)
    >>> sorted(calibration.subjects), calibration.k["walking"].shape
    (['simulated'], (1,))
    """

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

    __reduce__ = pickled

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            object.__setattr__(self, name, read_only(getattr(self, name), name))
        n, s = slices_of(self.models)[1], len(self.subject_ids)
        shapes = (n,), (n, n), (n, n), (s, n), (s, n, n), (s,)
        for name, shape in zip(_ARRAYS, shapes, strict=True):
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} must be {shape}, got {getattr(self, name).shape}")
        for name in self.models:
            check_name_of_context(name)
        check_columns(self.segments, _COLUMN_KINDS, "segments")
        _check_numbers(self)

    def __repr__(self) -> str:
        contexts = ", ".join(self.contexts) or "no context"
        return f"Calibration({contexts}; {len(self.subject_ids)} people, {len(self.segments)} segments)"

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
    def between(self) -> dict[str, FloatArray]:
        """Covariance (p, p) of the parameters between persons in each context."""
        return self._blocks(self.between_cov)

    @property
    def subjects(self) -> dict[str, CalibratedPerson]:
        """Calibrated persons by name."""
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

    def config(self, config: Config, subject: Subject | None = None) -> Config:
        """Return a configuration with the calibrated step lengths of a person, and a note that names the person.

        Contexts that were not calibrated keep the step lengths of the configuration. So do all contexts if every
        segment of the person contradicts the detected steps. Notes state this and all warnings of the calibration.

        Parameters
        ----------
        config : Config
            Configuration to change. It is not modified.
        subject : Subject, optional
            Subject of the recording; `person_of` selects the calibrated person.

        Returns
        -------
        Config
            Changed copy. Further notes name replaced step-length models, and step lengths without a mode.

        Raises
        ------
        ValueError
            If the configuration has no mode of any calibrated context.

        Notes
        -----
        The uncertainty of the parameters becomes the uncertainty of one factor for all steps, `scale_std`, because an
        error of the parameters is the same in all steps of a walk.
        """
        fits = self.fits(subject)
        own = self.mode_contexts
        names = {m.name: m.name if own.get(m.name) == m.context else m.context for m in config.model.modes}
        used = tuple(name for name in self.contexts if name in names.values())
        if self.contexts and not used:
            raise ValueError(
                f"the calibration has step lengths of {', '.join(self.contexts)}, but recipe {config.name!r} has the "
                f"modes {', '.join(names)}: give the configuration that was calibrated, or calibrate with this one"
            )
        person = self.person_of(subject)
        is_own = np.array([person in (None, subject_id) for subject_id in self.segments.subject.tolist()], dtype=bool)
        n_own, n_rejected, contradicted = int(is_own.sum()), int((is_own & self.segments.distrusted).sum()), ""
        if n_rejected:
            contradicted = (
                f"; {n_rejected} of {how_many(n_own, 'segment')} of the calibration contradict the detected steps "
                "and were not used: check that the known lengths are in metres, and calibrate again"
            )
        if not used or (n_rejected and n_rejected == n_own):
            # without a segment that fits, the parameters of a person are those of the prior
            text = f"step lengths {self._whose(subject)}: no context is calibrated; all keep the step lengths of the "
            return replace(config, notes=(*config.notes, Note("step lengths", f"{text}recipe{contradicted}")))
        sure = {name: replace(fits[name], theta_cov=np.zeros_like(fits[name].theta_cov)) for name in used}
        modes = tuple(replace(m, step_length=sure.get(names[m.name], m.step_length)) for m in config.model.modes)
        noise = replace(config.model.noise, log_scale_std=self.scale_std(subject))
        fitted = [c if self.k_cov[c].any() else f"{c} (held, not fitted)" for c in used]
        text = f"step lengths {self._whose(subject)}: calibrated for {', '.join(fitted)}; other contexts keep the step "
        found = [f"{text}lengths of the recipe{contradicted}"]
        found += [text.removeprefix("WARNING: ") for text in self.notes if text.startswith("WARNING: ")]
        if unused := set(self.contexts) - set(used):
            found.append(
                f"calibrated step lengths of {', '.join(sorted(unused))} are not used, because the recipe has no such "
                "modes: give the configuration that was calibrated"
            )
        notes = tuple(n for n in config.notes if n.about != "height" or person is None)
        notes += (*(Note("step lengths", text) for text in found), *_replaced(config.model.modes, modes))
        return replace(config.with_model(modes=modes, noise=noise), notes=notes)

    def _whose(self, subject: Subject | None) -> str:
        """Return a phrase that names the person whose parameters are used."""
        name, asked = self.person_of(subject), subject.id if subject else None
        n_people = len(self.subject_ids)
        of_all = f"of the calibrated population ({how_many(n_people, 'person', 'persons')})"
        if asked is not None:
            return f"of {asked}" if name else f"{of_all}, because {asked} was not calibrated"
        if name is None:
            return f"{of_all}, because the recording does not name its person"
        which = "the only calibrated person" if n_people == 1 else "who was calibrated without a name"
        return f"of {name}, {which}, because the recording does not name its person"

    def report(self) -> str:
        """Return parameters, errors and warnings as text.

        Returns
        -------
        str
            Several lines for a fixed-width font.
        """
        of_all = _once(self.notes)
        notes = [f"- {note}" for note in of_all[:_MOST_NOTES]]
        if len(of_all) > _MOST_NOTES:
            notes.append(f"- and {how_many(len(of_all) - _MOST_NOTES, 'more note')}")
        parts = [self._parameter_lines(), self._error_lines(), self._people_lines(), notes]
        return "\n\n".join("\n".join(lines) for lines in parts if lines)

    def _repr_markdown_(self) -> str:
        return f"```\n{self.report()}\n```"

    def tables(self) -> dict[str, Table]:
        """Return parameters, covariance and segments as tables, for example for a paper.

        Returns
        -------
        dict of str to Table
            "parameters" has `context`, `parameter` (numbered from 0), `value`, `std` and `between_std` (standard
            deviation between persons). "covariance" has a row for each pair of parameters: `context`, `parameter`,
            `other_context`, `other_parameter`, `covariance`. "segments" has the columns of `segments` and `residual_m`,
            the known length minus the length predicted without the segment.
        """
        parts = slices_of(self.models)[0]
        context = np.concatenate([np.full(part.stop - part.start, name) for name, part in parts.items()])
        number = np.concatenate([np.arange(part.stop - part.start) for part in parts.values()])
        row, column = np.indices(self.theta_cov.shape).reshape(2, -1)
        segments = {name: self.segments[name] for name in self.segments.dtype.names or ()}
        return {
            "parameters": table(
                {
                    "context": context,
                    "parameter": number,
                    "value": self.theta,
                    "std": np.sqrt(np.diagonal(self.theta_cov)),
                    "between_std": np.sqrt(np.diagonal(self.between_cov)),
                }
            ),
            "covariance": table(
                {
                    "context": context[row],
                    "parameter": number[row],
                    "other_context": context[column],
                    "other_parameter": number[column],
                    "covariance": self.theta_cov[row, column],
                }
            ),
            "segments": table({**segments, "residual_m": self.segments.distance_m - self.segments.left_out_m}),
        }

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw the held-out errors of the segments, and the step lengths of the persons with 95 % intervals.

        Persons are compared by the length of the same typical step of `main_context`, in m.

        Parameters
        ----------
        path : str or Path, optional
            File to which the figure is saved. The suffix gives the format.

        Returns
        -------
        matplotlib Figure
            Figure that belongs to no window, so that it need not be closed.
        """
        from pdr_filter.apps.report import plot

        main = self.main_context
        model, people = self.models[main], self.subjects
        lengths = {name: typical_step_m(model, p.k[main], p.k_cov[main]) for name, p in people.items()}
        # parameters that are independent between persons have an infinite variance, for which no band is drawn
        spread = np.where(np.isfinite(self.between[main]), self.between[main], np.nan)
        population = typical_step_m(model, self.k[main], spread)
        return plot.calibration(self.segments, main, lengths, population, path)

    def save(self, path: str | Path) -> Path:
        """Write the calibration to two files, NAME.json (description) and NAME.npz (arrays).

        Parameters
        ----------
        path : str or Path
            Path of either file, or NAME without a suffix.

        Returns
        -------
        Path
            Path of the .json file.

        Raises
        ------
        OSError
            If a file cannot be written.
        """
        arrays = {name: np.asarray(getattr(self, name)) for name in _ARRAYS}
        columns = self.segments.dtype.names or ()
        arrays |= prefixed(_SEGMENT, {name: np.asarray(self.segments[name]) for name in columns})
        description = {
            "models": {name: _model_to_plain(model) for name, model in self.models.items()},
            "subject_ids": list(self.subject_ids),
            "residual_std_m": dict(self.residual_std_m),
            "recording_std": self.recording_std,
            "n_segments": dict(self.n_segments),
            "notes": list(self.notes),
            "card": dict(self.card or {}),
            "mode_contexts": dict(self.mode_contexts),
        }
        FORMAT.write(path, description, arrays)
        return file_pair(path)[0]

    def _parameter_lines(self) -> list[str]:
        rows, n_people = self.segments, len(self.subject_ids)
        lines = [
            f"{how_many(len(rows), 'segment')}, {rows.distance_m.sum():.0f} m, "
            f"{how_many(len(set(rows.recording)), 'recording')}, {how_many(n_people, 'person', 'persons')}",
            "",
            f"{'context':<12}{'segments':>9}{'residual':>10}  model, below it k +- std (std between persons)",
        ]
        for name in self.contexts:
            k, std = self.k[name], np.sqrt(np.diagonal(self.k_cov[name]))
            between = np.sqrt(np.diagonal(self.between[name]))
            values = ", ".join(
                f"{a:.4g}" + (f" +- {b:.2g}" if b > 0 else " fixed") + (f" ({d:.2g})" if d > 0 else "")
                for a, b, d in zip(k, std, between, strict=True)
            )
            residual = f"{self.residual_std_m[name]:.3f} m"
            model = type(self.models[name]).__name__
            lines.append(f"{name:<12}{self.n_segments[name]:>9.1f}{residual:>10}  {model}")
            lines.append(f"  {values}")
        return [*lines, f"between recordings of one person: {100 * self.recording_std:.1f} %"]

    def _error_lines(self) -> list[str]:
        lines = [f"{'error of segments in %':<34}{'bias':>7}{'spread':>8}{'RMS':>7}"]
        for label, column in (
            ("uncalibrated (prior)", "uncalibrated_m"),
            ("calibrated, in sample", "predicted_m"),
            ("calibrated, segment held out", "left_out_m"),
            ("calibrated, person held out", "stranger_m"),
        ):
            bias, spread, rms = _errors_percent(self.segments[column], self.segments.distance_m)
            is_alone = column == "stranger_m" and len(self.subject_ids) < 2
            missing = "needs two persons" if is_alone else "not determined"
            values = f"{bias:>+7.1f}{spread:>8.1f}{rms:>7.1f}" if np.isfinite(rms) else f"{missing:>22}"
            lines.append(f"{label:<34}{values}")
        (_, _, before), (_, _, stranger) = (
            _errors_percent(self.segments[column], self.segments.distance_m)
            for column in ("uncalibrated_m", "stranger_m")
        )
        if stranger > before:
            lines.append(
                f"segments of held-out persons have an RMS error of {stranger:.1f} % with this calibration and of "
                f"{before:.1f} % without it: use it only for the calibrated persons"
            )
        return lines

    def _people_lines(self) -> list[str]:
        main, people, rows = self.main_context, self.subjects, cast(Any, self.segments)
        lines = [f"{'person (segments held out)':<34}{'segments':>9}{'bias %':>7}{'RMS %':>7}  k of {main} +- std"]
        for name in self.subject_ids[:_MOST_PEOPLE]:
            person = people[name]
            own = rows[rows.subject == name]
            bias, _, rms = _errors_percent(own.left_out_m, own.distance_m)
            std = np.sqrt(np.diagonal(person.k_cov[main]))
            values = ", ".join(f"{a:.4g} +- {b:.2g}" for a, b in zip(person.k[main], std, strict=True) if b > 0)
            errors = f"{bias:>+7.1f}{rms:>7.1f}" if np.isfinite(rms) else f"{'-':>7}{'-':>7}"
            lines.append(f"{_shortened(name):<34}{person.n_segments:>9}{errors}  {values}")
        if len(self.subject_ids) > _MOST_PEOPLE:
            lines.append(f"and {len(self.subject_ids) - _MOST_PEOPLE} more persons")
        return lines

    def _by_context(self, theta: FloatArray) -> dict[str, FloatArray]:
        return {name: theta[part] for name, part in slices_of(self.models)[0].items()}

    def _blocks(self, cov: FloatArray) -> dict[str, FloatArray]:
        return {name: cov[part, part] for name, part in slices_of(self.models)[0].items()}


def _check_numbers(calibration: Calibration) -> None:
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


def _replaced(before: Sequence[Mode], after: Sequence[Mode]) -> list[Note]:
    """Return a list with a note about modes whose step-length model differs in class after a calibration."""
    changed = [
        f"{type(new.step_length.model).__name__} in place of {type(old.step_length.model).__name__} for {old.name}"
        for old, new in zip(before, after, strict=True)
        if old.moves and type(old.step_length.model) is not type(new.step_length.model)
    ]
    if not changed:
        return []
    text = f"the calibration has other step-length models than the recipe, {', '.join(changed)}"
    remedy = "to keep those of the recipe, calibrate with its configuration, or with the name of its model (model)"
    return [Note("step lengths", f"{text}: {remedy}")]


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


def _errors_percent(predicted_m: FloatArray, distance_m: FloatArray) -> tuple[float, float, float]:
    """Return bias, standard deviation and RMS of the relative errors in per cent, NaN without errors."""
    error = 100 * (predicted_m / distance_m - 1)
    error = error[np.isfinite(error)]
    if len(error) == 0:
        return np.nan, np.nan, np.nan
    return float(error.mean()), float(error.std()), float(np.sqrt((error**2).mean()))


def _shortened(name: str) -> str:
    """Shorten a long name in the middle, because recordings differ at the start or at the end of their names."""
    return name if len(name) <= 32 else f"{name[:19]}...{name[-10:]}"


def load_calibration(path: Calibration | str | Path, config: Config | None = None) -> Calibration:
    """Load a calibration that `Calibration.save` has written.

    Parameters
    ----------
    path : str, Path or Calibration
        Path of the .json or the .npz file. A `Calibration` is returned unchanged.
    config : Config, optional
        Configuration with the step-length models whose classes are not part of this package. Such classes are not
        stored in the file.

    Returns
    -------
    Calibration
        Calibration for `pdr_filter.track` and `pdr_filter.smooth`.

    Raises
    ------
    ValueError
        If the file is damaged, is not a calibration, or needs `config`. The message names the file.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> import pdr_filter as pdr
    >>> from pdr_filter.recipes.step_length_calibration import load_calibration
    >>> legs = [pdr.simulate.Leg("walking", distance_m=d, turn_rad=1.57) for d in (30.0, 20.0)]
    >>> calibration = pdr.calibrate([pdr.simulate.simulate(legs)], model="tian")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = calibration.save(f"{folder}/mine")
    ...     load_calibration(path)
    Calibration(walking; 1 people, 2 segments)
    """
    if isinstance(path, Calibration):
        return path
    if not isinstance(path, str | PathLike):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ValueError(f"calibration must be a Calibration, or the path of a saved one, got {path!r}")
    return FORMAT.read(path, partial(_assemble, config))


def read_person(person: Person | Calibration | str | Path, config: Config | None = None) -> Person | Calibration:
    """Return a `Person` or a `Calibration`, loaded from a file if a path is given. ValueError names a bad file."""
    if isinstance(person, Person | Calibration):
        return person
    if not isinstance(person, str | PathLike):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ValueError(f"person must be a Person, a Calibration, or the path of a saved one, got {person!r}")
    return load_calibration(person, config) if FORMAT.is_at(person) else Person.load(person)


def with_steps_of(config: Config, person: Person | Calibration | str | Path, subject: Subject) -> Config:
    """Return a configuration with the step lengths of a `Person`, or of the subject in a `Calibration`."""
    known = read_person(person, config)
    return known.config(config, subject) if isinstance(known, Calibration) else config.with_person(known)


def _assemble(config: Config | None, description: Mapping[str, Any], arrays: Arrays) -> Calibration:
    """Create a calibration from the contents of its files. `FORMAT.read` turns errors into ValueError."""
    return Calibration(
        models={name: _model_from_plain(name, m, config) for name, m in description["models"].items()},
        **cast(Any, {name: arrays[name] for name in _ARRAYS}),
        subject_ids=tuple(description["subject_ids"]),
        residual_std_m=description["residual_std_m"],
        recording_std=float(description["recording_std"]),
        n_segments=description["n_segments"],
        segments=table(of_prefix(_SEGMENT, arrays)),
        notes=tuple(description["notes"]),
        card=description["card"],
        mode_contexts=description.get("mode_contexts", {}),
    )


def _once(notes: Sequence[str]) -> list[str]:
    """Return the notes without repetitions.

    Notes with the same text after the last colon, such as those of several recordings, become one note. It has the text
    of the first, and the number of the others.
    """
    alike: dict[str, list[str]] = {}
    for note in notes:
        alike.setdefault(note.rpartition(": ")[2], []).append(note)
    return [f"{first} (and {len(more)} similar notes)" if more else first for first, *more in alike.values()]


def is_shipped(model: StepLengthModel) -> bool:
    """Return True for step-length models of this package, whose class names are stored in files."""
    return getattr(step_length, type(model).__name__, None) is type(model)


def _model_to_plain(model: StepLengthModel) -> dict[str, Any]:
    if not is_shipped(model):
        return {"class": None, "n_params": model.n_params}
    # JSON has no infinity
    values = {f.name: getattr(model, f.name) for f in fields(cast(Any, model))}
    return {
        "class": type(model).__name__,
        **{n: None if v == np.inf else v for n, v in values.items() if n != "n_params"},
    }


def _model_from_plain(context: str, plain: Mapping[str, Any], config: Config | None) -> StepLengthModel:
    if plain["class"] is None:
        return _model_of(context, plain["n_params"], config)
    kind = getattr(step_length, str(plain["class"]), None)
    if not (isinstance(kind, type) and is_dataclass(kind) and hasattr(kind, "n_params")):
        raise ValueError(
            f"no step-length model {plain['class']!r}: the file was written by another "
            "version of pdr_filter; calibrate again"
        )
    values = {name: np.inf if v is None else float(v) for name, v in plain.items() if name not in ("class", "n_params")}
    return cast(StepLengthModel, kind(**values))


def _model_of(context: str, n_params: Any, config: Config | None) -> StepLengthModel:
    """Return the step-length model of a context from `config`, because the calibration file does not contain it.

    A file names the classes of this package (`is_shipped`). Of a user's own class it has only the number of parameters,
    `n_params`. ValueError unless `config` has a model of such a class, with that number, for the context.
    """
    modes = () if config is None else config.model.modes
    named = [mode for mode in modes if mode.name == context] or [mode for mode in modes if mode.context == context]
    model = named[0].step_length.model if named else None
    if model is None or is_shipped(model) or model.n_params != n_params:
        raise ValueError(
            f"the step-length model of {context} has a class outside of pdr_filter, "
            f"with {n_params} parameters: pass the "
            "configuration with this model, config.with_step_length(...)"
        )
    return model
