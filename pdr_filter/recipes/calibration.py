"""Use of calibrated step lengths by the filter. This module does not need gtsam."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pdr_filter.classifiers.model_files import Arrays
from pdr_filter.filter.imm.motion_model import Mode
from pdr_filter.filter.pedestrian.person import Person
from pdr_filter.filter.step_length import calibration_files
from pdr_filter.filter.step_length.calibration_files import FORMAT
from pdr_filter.filter.step_length.calibration_report import report_tables, report_text
from pdr_filter.filter.step_length.calibration_result import CalibrationResult, typical_step_m
from pdr_filter.recipes.config import Config
from pdr_filter.values import Note, Table, how_many
from pdr_filter.values.recording import Subject

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(CalibrationResult):
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

    def __repr__(self) -> str:
        contexts = ", ".join(self.contexts) or "no context"
        return f"Calibration({contexts}; {len(self.subject_ids)} people, {len(self.segments)} segments)"

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
        is_height_used = person is not None or (subject is not None and subject.height_m is not None)
        notes = tuple(n for n in config.notes if n.about != "height" or not is_height_used)
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
        return report_text(self)

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
        return report_tables(self)

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
        return calibration_files.write_calibration(path, self)


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
    >>> from pdr_filter.recipes.calibration import load_calibration
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
    modes = () if config is None else config.model.modes
    own = [(mode.name, mode.context, mode.step_length.model) for mode in modes]

    def build(description: Mapping[str, Any], arrays: Arrays) -> Calibration:
        return Calibration(**calibration_files.values_of(description, arrays, own))

    return FORMAT.read(path, build)


def read_person(person: Person | Calibration | str | Path, config: Config | None = None) -> Person | Calibration:
    """Return a `Person` or a `Calibration`, loaded from a file if a path is given. ValueError names a bad file."""
    if isinstance(person, Person | Calibration):
        return person
    if not isinstance(person, str | PathLike):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ValueError(f"person must be a Person, a Calibration, or the path of a saved one, got {person!r}")
    if FORMAT.is_at(person):
        return load_calibration(person, config)
    try:
        return Person.load(person)
    except ValueError as error:
        raise ValueError(f"{error}, or a calibration with pdr-filter calibrate") from None


def with_steps_of(config: Config, person: Person | Calibration | str | Path, subject: Subject) -> Config:
    """Return a configuration with the step lengths of a `Person`, or of the subject in a `Calibration`."""
    known = read_person(person, config)
    return known.config(config, subject) if isinstance(known, Calibration) else config.with_person(known)
