"""Step-length parameters of people, with covariance: saved, loaded, and used by the filter. Needs no gtsam."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from pdr_filter.classifiers.model_files import Arrays, ArtefactFormat, file_pair, of_prefix, prefixed
from pdr_filter.filter.step_length import models as step_length
from pdr_filter.filter.step_length.models import TYPICAL_STEP, StepLengthFit, StepLengthModel, length_and_jacobian
from pdr_filter.filter.step_length.person import Person
from pdr_filter.recipes.config import Config
from pdr_filter.values import (
    FloatArray,
    Note,
    Table,
    check_array,
    check_columns,
    check_cov,
    check_name_of_context,
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
_SEGMENT = "segment_"  # before the names of the columns of `segments`
_TEXTS, _FLAGS = ("subject", "recording", "context"), ("summed", "distrusted")
_LENGTHS = ("distance_m", "predicted_m", "left_out_m", "stranger_m", "uncalibrated_m")
_COLUMN_KINDS = {
    **dict.fromkeys(_TEXTS, "U"),
    **dict.fromkeys(_FLAGS, "b"),
    **dict.fromkeys(("start_s", "end_s", "n_steps", "misfit", "weight", *_LENGTHS), "if"),
}
_LARGEST_STD = 1e3  # no step is longer, in m, and nobody as far from others: it says that nothing is known
_MOST_PEOPLE, _MOST_NOTES = 20, 12  # in the report
# Whose recordings are that do not say it: somebody who calibrates his own steps seldom gives himself a name.
UNNAMED = "unnamed"
# Heights of one person, as two recordings state them, differ by less.
_SAME_HEIGHT_M = 0.02


@dataclass(frozen=True, eq=False)
class CalibratedPerson:
    """What was found of one person."""

    id: str
    height_m: float | None  # that of the models; the parameters belong to it
    # Parameters (p,) of each context and their covariance (p, p). Of contexts without segments they are the
    # population's, with the spread between people.
    k: Mapping[str, FloatArray]
    k_cov: Mapping[str, FloatArray]
    n_segments: int
    main_context: str = "walking"  # of the calibration

    @property
    def k0(self) -> float:
        """First parameter of walking, or of the `main_context` of the calibration."""
        return float(self.k[self.main_context][0])


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """Step-length parameters of a population and its people, per context.

    Parameters
    ----------
    models : dict
        Step-length model of each context.
    theta, theta_cov : (P,), (P, P)
        Of the population, all contexts one after the other in the order of `models`, and how well they are known.
    between_cov : (P, P)
        How people differ from it.
    people, people_cov : (S, P), (S, P, P)
    subject_ids : (S,)
    heights_m : (S,)
        NaN where unknown.
    residual_std_m : dict
        Of single steps in each context.
    recording_std : float
        How one person's scale differs between recordings, relative.
    n_segments : dict
        How many segments, in steps' shares, each context had.
    segments : table
        One row for each segment: `subject, recording, context, start_s, end_s, distance_m, n_steps, summed` (lengths
        and not displacement), `predicted_m`, `left_out_m` (without this segment), `stranger_m` (without this person,
        NaN for only one), `uncalibrated_m`, `misfit` (distance from what all others say, in standard deviations),
        `weight`, `distrusted`.
    notes : tuple of str
        Warnings, what was left out, taken otherwise, or distrusted.
    card : dict
        Version, date and what else people should know.
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

    __reduce__ = pickled

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            object.__setattr__(self, name, read_only(getattr(self, name)))
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
        """Contexts that are the main one of a segment: those that a few doubtful steps hint at are not calibrated."""
        found = set(self.segments.context.tolist())
        k, k_cov = self.k, self.k_cov
        return tuple(c for c in self.models if c in found and (k[c].any() or k_cov[c].any()))

    @property
    def main_context(self) -> str:
        """Walking if it was calibrated, else the first context that was."""
        names = self.contexts or tuple(self.models)
        return "walking" if "walking" in names or not names else names[0]

    @property
    def k(self) -> dict[str, FloatArray]:
        """Parameters of the population in each context."""
        return self._by_context(self.theta)

    @property
    def k_cov(self) -> dict[str, FloatArray]:
        """How well the population's parameters are known."""
        return self._blocks(self.theta_cov)

    @property
    def between(self) -> dict[str, FloatArray]:
        """Covariance between people in each context."""
        return self._blocks(self.between_cov)

    @property
    def subjects(self) -> dict[str, CalibratedPerson]:
        """The people, by id."""
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
        """Segments whose residual is beyond three standard deviations."""
        return self.segments[self.segments.distrusted].view(np.recarray)

    def person_of(self, subject: Subject | str | None = None) -> str | None:
        """Whose parameters are used for somebody: an id, or None for the population's.

        Where a recording does not say whose it is, the calibration's only person, or the one who was calibrated without
        a name; unless the heights of the two are known and differ.
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
        """Model, parameters and covariance in each context, for a person (`person_of`).

        Of somebody who was not calibrated they are the population's; how people differ from it is not in `theta_cov`
        then, but in `scale_std`: it is one factor for all steps of the person.
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
        """Relative standard deviation of all of a person's step lengths together, of walking if it was calibrated.

        It has how well the person is known (or how people differ, for somebody who was not calibrated), and how a
        person differs between recordings.
        """
        context = self.main_context
        fit = self.fits(subject)[context]
        cov = fit.theta_cov + self.between[context] if self.person_of(subject) is None else fit.theta_cov
        length_m, std_m = typical_step_m(fit.model, fit.theta, cov)
        relative = std_m / max(length_m, 1e-3)
        return float(np.hypot(min(relative, 1.0), self.recording_std))

    def config(self, config: Config, subject: Subject | None = None) -> Config:
        """The configuration with the calibrated step lengths of a person, how sure they are, and a note whose they are.

        Contexts that no segment said anything about keep the lengths of the configuration. The uncertainty is one
        factor of all steps of the walk, `scale_std`: errors of parameters do not differ from step to step.
        """
        fits = self.fits(subject)
        used = self.contexts
        sure = {name: replace(fits[name], theta_cov=np.zeros_like(fits[name].theta_cov)) for name in used}
        modes = tuple(replace(m, step_length=sure.get(m.context, m.step_length)) for m in config.model.modes)
        noise = replace(config.model.noise, log_scale_std=self.scale_std(subject))
        name = self.person_of(subject)
        note = Note("step lengths", f"step lengths {self._whose(subject)}: {', '.join(used) or 'none calibrated'}")
        notes = tuple(n for n in config.notes if n.about != "height" or name is None)
        return replace(config.with_model(modes=modes, noise=noise), notes=(*notes, note))

    def _whose(self, subject: Subject | None) -> str:
        """Whose parameters are used, in words."""
        name, asked = self.person_of(subject), subject.id if subject else None
        n_people = len(self.subject_ids)
        of_all = f"of the calibrated population ({how_many(n_people, 'person', 'people')})"
        if asked is not None:
            return f"of {asked}" if name else f"{of_all}, as {asked} was not calibrated"
        if name is None:
            return f"{of_all}, as the recording does not say whose it is"
        which = "the calibrated person" if n_people == 1 else "who was calibrated without a name"
        return f"of {name}, {which}, as the recording does not say whose it is"

    def report(self) -> str:
        """Parameters, errors and doubts as text."""
        of_all = _once(self.notes)
        notes = [f"- {note}" for note in of_all[:_MOST_NOTES]]
        if len(of_all) > _MOST_NOTES:
            notes.append(f"- and {how_many(len(of_all) - _MOST_NOTES, 'more note')}")
        parts = [self._parameter_lines(), self._error_lines(), self._people_lines(), notes]
        return "\n\n".join("\n".join(lines) for lines in parts if lines)

    def _repr_markdown_(self) -> str:
        return f"```\n{self.report()}\n```"

    def tables(self) -> dict[str, Table]:
        """Return the tables of a paper: `parameters`, `covariance` and `segments`.

        `parameters` has `context`, `parameter` (numbered from 0), `value`, `std` and `between_std` (of people).
        `covariance` has a row for each pair of parameters: `context`, `parameter`, `other_context`,
        `other_parameter`, `covariance`. `segments` are those of the calibration with `residual_m`, the known length
        less that predicted without the segment.
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
        """Known against predicted lengths of the segments and people with 95 % intervals, saved if a path is given.

        People are compared by the length in m of one and the same step, at one height.
        """
        from pdr_filter.report import plot

        main = self.main_context
        model, people = self.models[main], self.subjects
        lengths = {name: typical_step_m(model, p.k[main], p.k_cov[main]) for name, p in people.items()}
        # A parameter that is each person's own without a tie has an infinite spread: there is no band then.
        spread = np.where(np.isfinite(self.between[main]), self.between[main], np.nan)
        population = typical_step_m(model, self.k[main], spread)
        return plot.calibration(self.segments, main, lengths, population, path)

    def save(self, path: str | Path) -> Path:
        """Write `<name>.npz` (plain arrays) and `<name>.json` (the card) and return the path of the .json."""
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
        }
        FORMAT.write(path, description, arrays)
        return file_pair(path)[0]

    def _parameter_lines(self) -> list[str]:
        rows, n_people = self.segments, len(self.subject_ids)
        lines = [
            f"{how_many(len(rows), 'segment')}, {rows.distance_m.sum():.0f} m, "
            f"{how_many(len(set(rows.recording)), 'recording')}, {how_many(n_people, 'person', 'people')}",
            "",
            f"{'context':<12}{'segments':>9}{'residual':>10}  model, below it k +- std (people differ by)",
        ]
        for name in self.contexts:
            k, std = self.k[name], np.sqrt(np.diagonal(self.k_cov[name]))
            between = np.sqrt(np.diagonal(self.between[name]))
            values = ", ".join(
                f"{a:.4g}" + (f" +- {b:.2g}" if b > 0 else " held") + (f" ({d:.2g})" if d > 0 else "")
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
            ("calibrated, segment left out", "left_out_m"),
            ("calibrated, person left out", "stranger_m"),
        ):
            bias, spread, rms = _errors_percent(self.segments[column], self.segments.distance_m)
            missing = "needs two people" if len(self.subject_ids) < 2 else "not determined"
            values = f"{bias:>+7.1f}{spread:>8.1f}{rms:>7.1f}" if np.isfinite(rms) else f"{missing:>22}"
            lines.append(f"{label:<34}{values}")
        (_, _, before), (_, _, stranger) = (
            _errors_percent(self.segments[column], self.segments.distance_m)
            for column in ("uncalibrated_m", "stranger_m")
        )
        if stranger > before:
            lines.append(
                f"strangers' segments are {stranger:.1f} % off with it and {before:.1f} % without: use it for the "
                "people who were calibrated"
            )
        return lines

    def _people_lines(self) -> list[str]:
        main, people, rows = self.main_context, self.subjects, cast(Any, self.segments)
        lines = [f"{'person (segments left out)':<34}{'segments':>9}{'bias %':>7}{'RMS %':>7}  k of {main} +- std"]
        for name in self.subject_ids[:_MOST_PEOPLE]:
            person = people[name]
            own = rows[rows.subject == name]
            bias, _, rms = _errors_percent(own.left_out_m, own.distance_m)
            std = np.sqrt(np.diagonal(person.k_cov[main]))
            values = ", ".join(f"{a:.4g} +- {b:.2g}" for a, b in zip(person.k[main], std, strict=True) if b > 0)
            lines.append(f"{_shortened(name):<34}{person.n_segments:>9}{bias:>+7.1f}{rms:>7.1f}  {values}")
        if len(self.subject_ids) > _MOST_PEOPLE:
            lines.append(f"and {len(self.subject_ids) - _MOST_PEOPLE} more people")
        return lines

    def _by_context(self, theta: FloatArray) -> dict[str, FloatArray]:
        return {name: theta[part] for name, part in slices_of(self.models)[0].items()}

    def _blocks(self, cov: FloatArray) -> dict[str, FloatArray]:
        return {name: cov[part, part] for name, part in slices_of(self.models)[0].items()}


def _check_numbers(calibration: Calibration) -> None:
    """Numbers that a filter can use: what one person's parameters are is known, however people differ."""
    for name in ("theta", "people"):
        check_array(name, getattr(calibration, name))
    for name in ("theta_cov", "people_cov"):
        check_cov(getattr(calibration, name), name)
    if not (np.diagonal(calibration.between_cov) >= 0).all():
        raise ValueError("between_cov must have variances on its diagonal")
    heights_m, (least_m, largest_m) = calibration.heights_m, HEIGHT_RANGE_M
    if ((heights_m < least_m) | (heights_m > largest_m)).any():
        raise ValueError(f"heights_m must be {least_m} to {largest_m}, NaN where unknown, got {heights_m}")
    for name in ("residual_std_m", "n_segments"):
        if not set(calibration.models) <= set(getattr(calibration, name)):
            raise ValueError(f"{name} must be there for each of {tuple(calibration.models)}")
    known = {**calibration.residual_std_m, "recording_std": calibration.recording_std}
    if not all(0 <= std <= _LARGEST_STD for std in known.values()):
        raise ValueError(f"residual_std_m and recording_std must be from 0 to {_LARGEST_STD}, got {known}")
    if calibration.main_context not in calibration.models:
        raise ValueError("models must hold that of one context at least, got none")


def slices_of(models: Mapping[str, StepLengthModel]) -> tuple[dict[str, slice], int]:
    """Where the parameters of each context are in theta (P,), and P."""
    ends = np.cumsum([0, *(m.n_params for m in models.values())])
    return {name: slice(int(a), int(b)) for name, (a, b) in zip(models, pairwise(ends), strict=True)}, int(ends[-1])


def of_height(model: StepLengthModel, height_m: float | None) -> StepLengthModel:
    """The model for a person of this height; itself if it takes no height or none is known."""
    if height_m is None or not hasattr(model, "height_m") or not is_dataclass(model):
        return model
    return replace(model, height_m=float(height_m))  # pyright: ignore[reportArgumentType, reportCallIssue, reportUnknownVariableType, reportGeneralTypeIssues, reportTypeVar]


def typical_step_m(model: StepLengthModel, theta: FloatArray, cov: FloatArray) -> tuple[float, float]:
    """Length of a typical step and its standard deviation under the covariance of theta, both in m."""
    length, jacobian = length_and_jacobian(model, TYPICAL_STEP, theta)
    return float(length), float(np.sqrt(jacobian @ cov @ jacobian))


def _errors_percent(predicted_m: FloatArray, distance_m: FloatArray) -> tuple[float, float, float]:
    """Bias, spread and RMS of the relative errors in %, NaN if there are none."""
    error = 100 * (predicted_m / distance_m - 1)
    error = error[np.isfinite(error)]
    if len(error) == 0:
        return np.nan, np.nan, np.nan
    return float(error.mean()), float(error.std()), float(np.sqrt((error**2).mean()))


def _shortened(name: str) -> str:
    """A long name without its middle: its ends distinguish recordings."""
    return name if len(name) <= 32 else f"{name[:19]}...{name[-10:]}"


def load_calibration(path: Calibration | str | Path, config: Config | None = None) -> Calibration:
    """A saved calibration, from the path of its .json or .npz; ValueError names the file and the remedy.

    `config` has the step-length models of classes outside of this package, which a file does not name.
    """
    if isinstance(path, Calibration):
        return path
    if not isinstance(path, str | PathLike):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ValueError(f"calibration must be a Calibration, or the path of a saved one, got {path!r}")
    return FORMAT.read(path, partial(_assemble, config))


def read_person(person: Person | Calibration | str | Path, config: Config | None = None) -> Person | Calibration:
    """A person, or a calibration that knows one, from what was saved of either; ValueError names the file."""
    if isinstance(person, Person | Calibration):
        return person
    if not isinstance(person, str | PathLike):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ValueError(f"person must be a Person, a Calibration, or the path of a saved one, got {person!r}")
    return load_calibration(person, config) if FORMAT.is_at(person) else Person.load(person)


def with_steps_of(config: Config, person: Person | Calibration | str | Path, subject: Subject) -> Config:
    """The configuration with the step lengths of a person, which may be one of those who were calibrated."""
    known = read_person(person, config)
    return known.config(config, subject) if isinstance(known, Calibration) else config.with_person(known)


def _assemble(config: Config | None, description: Mapping[str, Any], arrays: Arrays) -> Calibration:
    """Return the calibration; KeyError, TypeError or ValueError if anything is missing or does not fit."""
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
    )


def _once(notes: Sequence[str]) -> list[str]:
    """Notes of which many end alike, as those of recordings do, once, with how many there are more."""
    alike: dict[str, list[str]] = {}
    for note in notes:
        alike.setdefault(note.rpartition(": ")[2], []).append(note)
    return [f"{first} (and {len(more)} more alike)" if more else first for first, *more in alike.values()]


def is_shipped(model: StepLengthModel) -> bool:
    """True of the models of this package, which a file can name."""
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
        raise ValueError(f"no step-length model {plain['class']!r}")
    values = {name: np.inf if v is None else float(v) for name, v in plain.items() if name not in ("class", "n_params")}
    return cast(StepLengthModel, kind(**values))


def _model_of(context: str, n_params: Any, config: Config | None) -> StepLengthModel:
    """The model that a configuration has for a context, in place of one that a file cannot name."""
    modes = () if config is None else config.model.modes
    model = next((mode.step_length.model for mode in modes if mode.context == context), None)
    if model is None or is_shipped(model) or model.n_params != n_params:
        raise ValueError(
            f"its step-length model of {context} is of a class outside of pdr_filter, with {n_params} parameters: give "
            "the configuration that has it, config.with_step_length(...)"
        )
    return model
