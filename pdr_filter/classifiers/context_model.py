"""Context models: a trained classifier with everything needed to use it, in files without code.

A model is `<name>.npz` (plain arrays) and `<name>.json` (feature names, classes and the model card: data, date,
versions, metrics). Reading never unpickles anything, and all content is checked before it is used.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from pdr_filter.classifiers.base_classifier import Machine
from pdr_filter.classifiers.blend import MACHINES, kind_of
from pdr_filter.classifiers.familiarity import Familiarity, unknown_share
from pdr_filter.classifiers.model_files import Arrays, ArtefactFormat, file_pair, of_prefix, with_prefix
from pdr_filter.classifiers.probability_calibration import slipped_prob, tempered_prob
from pdr_filter.values import (
    CARRYING_MODES,
    CONTEXTS,
    FeatureFunction,
    FeatureSet,
    FloatArray,
    as_plain,
    check_array,
    check_name_of_context,
    check_transition_prob,
    feature_set_of,
    how_many,
    read_only,
    reduction,
)
from pdr_filter.values.serialisation import Shipped

# Version 2 added heads, temperature, the limit of the features, and familiarity.
FORMAT = ArtefactFormat("context_model", 2, "train it again, or use the version that wrote it")

# Default labels of each kind of model: contexts or carrying modes.
HEADS: dict[str, tuple[str, ...]] = {"context": CONTEXTS, "carrying_mode": CARRYING_MODES}
# Default labels of level walking, stairs up and stairs down, for models with familiarity of stairs.
STAIRS_LABELS = ("walking", "upstairs", "downstairs")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")  # a valid file name on all systems
# Numbers and arrays that are stored as arrays of the same names.
_NUMBERS = ("temperature", "slip", "feature_limit")
# Fields of the description that files of older models lack.
_OPTIONAL = ("labels", "stairs_labels", "needs_gyroscope", "evidence_exponent", "prior_exponent")
_ARRAYS = ("training_prior", "feature_mean", "feature_scale")
_MIN_DIVISOR = 1e-30  # smallest divisor, so that quotients do not overflow
# Prefixes of the arrays of parts.
_MACHINE, _FAMILIARITY, _STAIRS = "machine_", "familiarity_", "stairs_"

# Shares of level steps, steps up and steps down of a day: of 6,000 steps, ten flights of 16 steps lead up and ten down.
_DAILY_STEP_SHARES = read_only(np.array([0.94, 0.03, 0.03]))

# Models are inside the package in a wheel, and at the top level in a checkout.
_PACKAGE = Path(__file__).resolve().parents[1]
_SHIPPED = (_PACKAGE / "models", _PACKAGE.parent / "models")


class Assessment(NamedTuple):
    """Result of a model for one window: the probabilities of the labels, and two unknown shares.

    A share of 0 means that the window is like the training windows, and 1 that it is unlike all of them. One share
    compares the window with all training windows, the other one with the training windows on stairs.
    """

    prob: FloatArray  # (L,) probabilities of the labels
    unknown_share: float  # dissimilarity to all training windows, 0 to 1
    stairs_unknown_share: float  # dissimilarity to the training windows on stairs, 0 to 1
    is_unlike: bool  # farther from all training windows than most windows of held-out people


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ContextModel(Shipped):
    """Trained classifier of contexts or carrying modes: features of a window in, calibrated probabilities out.

    F is the number of features, K the number of classes in the training data, and L the number of labels.

    Parameters
    ----------
    name : str
        Name of the model and of its files.
    feature_names : tuple of str, length F
        Features, in the order of the input of `predict`.
    classes : tuple of str, length K
        Labels in the training data, in the order of the probabilities of `machine`. A subset of `labels`.
    training_prior : array_like, shape (L,)
        Share of each label in the training data. The shares sum to one, and are zero for labels that are not in the
        data.
    feature_mean, feature_scale : array_like, shape (F,)
        Standardisation of the features: (features - mean) / scale. Zeros and ones for a forest.
    machine : Machine
        Classifier that returns probabilities in the order of `classes`.
    card : dict
        Model card: data, date, versions, metrics. Any JSON values.
    head : {"context", "carrying_mode"}
        Kind of the labels: contexts of motion, or carrying modes of the phone.
    temperature : float, default 1.0
        Divisor of the logits (`probability_calibration.tempered_prob`), fitted on held-out people.
    slip : float, default 0.0
        Probability that a window belongs to any class with equal probability (`probability_calibration.slipped_prob`),
        fitted with the temperature.
    feature_limit : float, default inf
        Standardised features are cut at plus and minus this value, so that an unfamiliar value of one feature cannot
        dominate all other features.
    familiarity : Familiarity, optional
        Distance of a window to the training windows. The unknown share of a window follows from it: 0 for a window like
        the training windows, and nearly 1 for unfamiliar motion. Without it the unknown share is always zero.
    stairs : Familiarity, optional
        Distance of a window to the training windows on stairs. If a window is unlike all of them, the model cannot tell
        stairs from level walking in this window. The probabilities of the three `stairs_labels` are then partly
        replaced by a prior (`blend_stairs_with_prior`).
    labels : tuple of str, length L, optional
        Labels, in the order of the probabilities. The default is `CONTEXTS` or `CARRYING_MODES`.
    stairs_labels : tuple of str, length 3
        Labels of level walking, stairs up and stairs down, to which `stairs` applies.
    transition_prob : array_like, shape (L, L), optional
        Transition probabilities between labels from one step to the next, estimated from the labels of the training
        data. Rows sum to one.
    evidence_exponent, prior_exponent : float, optional
        Exponents e and r of the evidence of a window for a context, (p / prior^r)^e. Here p is the probability of the
        context and prior its `training_prior`. The exponents were chosen on the labels of the training data, and
        replace the defaults of `PedestrianModel`.
    features : FeatureSet, optional
        Computes the features of windows, if they are not features of this package. Files do not contain it.
    needs_gyroscope : bool, default True
        False if the model was trained on windows without angular rate.

    Raises
    ------
    ValueError
        If the parts do not fit together.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> model = pdr.ContextModel.load("context")
    >>> model.contexts
    ('stationary', 'walking', 'upstairs', 'downstairs', 'sideways', 'running')
    >>> model.renamed({"stationary": "resting", "walking": "level"}).contexts[:2]
    ('resting', 'level')
    """

    name: str
    feature_names: tuple[str, ...]
    classes: tuple[str, ...]
    training_prior: FloatArray
    feature_mean: FloatArray
    feature_scale: FloatArray
    machine: Machine
    card: dict[str, Any]
    head: str = "context"
    temperature: float = 1.0
    slip: float = 0.0
    feature_limit: float = np.inf
    familiarity: Familiarity | None = None
    stairs: Familiarity | None = None
    labels: tuple[str, ...] = ()
    stairs_labels: tuple[str, str, str] = STAIRS_LABELS
    transition_prob: FloatArray | None = None
    evidence_exponent: float | None = None
    prior_exponent: float | None = None
    features: FeatureSet | None = None
    needs_gyroscope: bool = True
    # Checksum of the files of a shipped model; empty for any other, and for a changed copy.
    _checksum: str = field(default="", init=False, repr=False)

    __reduce__ = reduction

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", tuple(self.labels) or HEADS.get(self.head, ()))
        for name in ("feature_names", "classes", "stairs_labels"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        for name in _ARRAYS:
            object.__setattr__(self, name, read_only(getattr(self, name), name))
        if self.transition_prob is not None:
            object.__setattr__(self, "transition_prob", read_only(self.transition_prob, "transition_prob"))
        _check(self)

    def __repr__(self) -> str:
        kind, n_features = type(self.machine).__name__, len(self.feature_names)
        return f"ContextModel({self.name!r}, {kind} of {n_features} features, labels {', '.join(self.labels)})"

    @property
    def contexts(self) -> tuple[str, ...]:
        """Labels of the model, in the order of the probabilities."""
        return self.labels

    def reference(self) -> tuple[str, str] | None:
        """Return name and checksum of a shipped model, otherwise None.

        Returns
        -------
        tuple of str, or None
            Name and checksum, by which a saved filter refers to the model.
        """
        return (self.name, self._checksum) if self._checksum else None

    @classmethod
    def of_reference(cls, name: str, checksum: str) -> ContextModel:
        """Return a shipped model by name and checksum.

        Parameters
        ----------
        name : str
            Name of the model.
        checksum : str
            Checksum from `reference`.

        Returns
        -------
        ContextModel
            The model.

        Raises
        ------
        ValueError
            If the package has no model of this name, or a model with another checksum.
        """
        path = _shipped_path(name)
        shipped = None if path is None else _shipped_at(path)
        if shipped is None or shipped._checksum != checksum:
            raise ValueError(
                f"this version has {'no' if shipped is None else 'another'} context model {name[:60]!r} of the saved "
                "filter: continue with models of this version, OnlineFilter.load(blob, config=config), and save the "
                "next filters with OnlineFilter.save(models=True)"
            )
        return shipped

    def renamed(self, names: Mapping[str, str]) -> ContextModel:
        """Return a copy with renamed labels.

        Parameters
        ----------
        names : mapping of str to str
            New names by present labels.

        Returns
        -------
        ContextModel
            Copy with the new names.

        Raises
        ------
        ValueError
            If a key is not a label of the model.
        """
        if unknown := set(names) - set(self.labels):
            raise ValueError(
                f"names has unknown labels {', '.join(sorted(unknown))}: use labels of {self.labels} as keys"
            )
        level, up, down = (names.get(label, label) for label in self.stairs_labels)
        return replace(
            self,
            classes=tuple(names.get(label, label) for label in self.classes),
            labels=tuple(names.get(label, label) for label in self.labels),
            stairs_labels=(level, up, down),
        )

    def predict(self, features: FloatArray) -> FloatArray:
        """Return the probabilities of all labels for one window.

        Parameters
        ----------
        features : ndarray, shape (F,)
            Features of the window.

        Returns
        -------
        ndarray, shape (L,)
            Probabilities in the order of `labels`, which sum to one. Zero for labels that are not in the training data.

        Raises
        ------
        ValueError
            If the shape is wrong, or a feature is NaN or infinite. The message names the feature.
        """
        return self.assess(features)[0]

    def assess(self, features: FloatArray) -> Assessment:
        """Return the probabilities for one window, and its dissimilarity to the training data.

        Parameters
        ----------
        features : ndarray, shape (F,)
            Features of the window.

        Returns
        -------
        Assessment
            Probabilities of all labels, and unknown shares (`Familiarity`).

        Raises
        ------
        ValueError
            If the shape is wrong, or a feature is NaN or infinite. The message names the feature.
        """
        return self.assess_all(np.asarray(features)[None])[0]

    def assess_all(self, features: FloatArray) -> list[Assessment]:
        """Return the result of `assess` for many windows, identical to the last bit.

        Parameters
        ----------
        features : ndarray, shape (W, F)
            Features of the windows.

        Returns
        -------
        list of Assessment
            Probabilities and unknown shares, one for each window.

        Raises
        ------
        ValueError
            If the shape is wrong, or a feature is NaN or infinite. The message names the feature.
        """
        values = np.ascontiguousarray(features, dtype=np.float64)  # sums depend on the memory layout in the last bits
        if values.ndim != 2 or values.shape[1] != len(self.feature_names):
            raise ValueError(
                f"model {self.name!r} needs {len(self.feature_names)} features of each window, a row for each, got "
                f"{values.shape}: compute them with the feature set of the model, in the order of its feature_names"
            )
        finite = np.isfinite(values)
        if not finite.all():
            window, index = np.argwhere(~finite)[0].tolist()
            raise ValueError(
                f"feature {index} ({self.feature_names[index]}) is {values[window, index]}: "
                "leave such windows out or fill in a value"
            )
        standardised = self.standardised(values)
        known = self.familiarity
        distance = np.zeros(len(values)) if known is None else known.distance(standardised)
        unknown = distance if known is None else unknown_share(distance, known.limit, known.sharpness)
        prob, unlike_stairs = self._prob_with_stairs(standardised)
        prob = prob / prob.sum(axis=1, keepdims=True)
        unlike = [False] * len(values) if known is None else known.is_unlike(distance).tolist()
        columns = prob, unknown.tolist(), unlike_stairs.tolist(), unlike
        return [Assessment(*each) for each in zip(*columns, strict=True)]

    def standardised(self, features: FloatArray) -> FloatArray:
        """Standardise features by the mean and the spread of the training windows.

        Parameters
        ----------
        features : ndarray, shape (..., F)
            Features of windows.

        Returns
        -------
        ndarray, shape (..., F)
            Standardised features, not cut at `feature_limit`.
        """
        return (features - self.feature_mean) / self.feature_scale

    def probabilities(self, features: FloatArray) -> FloatArray:
        """Return the probabilities of all labels for many windows.

        Parameters
        ----------
        features : ndarray, shape (W, F)
            Features of the windows.

        Returns
        -------
        ndarray, shape (W, L)
            Probabilities in the order of `labels`.
        """
        return self._prob_with_stairs(self.standardised(features))[0]

    def _prob_with_stairs(self, standardised: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return probabilities (W, L), and how unlike the training windows on stairs each window is, (W,)."""
        prob = self._predict_standardised(standardised)
        if self.stairs is None:
            return prob, np.zeros(len(prob))
        unlike = self.stairs.unknown_share(standardised)
        return blend_stairs_with_prior(prob, unlike, [self.labels.index(label) for label in self.stairs_labels]), unlike

    def _predict_standardised(self, rows: FloatArray) -> FloatArray:
        cut = np.clip(rows, -self.feature_limit, self.feature_limit)
        prob = np.zeros((len(rows), len(self.labels)))
        known = slipped_prob(tempered_prob(self.machine.predict_proba(cut), self.temperature), self.slip)
        prob[:, [self.labels.index(c) for c in self.classes]] = known
        return prob

    def save(self, folder: str | Path) -> Path:
        """Write `<name>.npz` and `<name>.json`.

        A feature function is not written: give it to `load` again.

        Parameters
        ----------
        folder : str or Path
            Folder of the files.

        Returns
        -------
        Path
            The written .npz.

        Raises
        ------
        ValueError
            If the classifier is of another library. The message names other ways to keep it.
        """
        arrays: Arrays = {name: np.asarray(getattr(self, name)) for name in (*_ARRAYS, *_NUMBERS)}
        if self.familiarity is not None:
            arrays |= with_prefix(_FAMILIARITY, self.familiarity.to_arrays())
        if self.stairs is not None:
            arrays |= with_prefix(_STAIRS, self.stairs.to_arrays())
        if self.transition_prob is not None:
            arrays["transition_prob"] = self.transition_prob
        arrays |= with_prefix(_MACHINE, self.machine.to_arrays())
        description = {
            "name": self.name,
            "head": self.head,
            "machine": kind_of(self.machine),
            **{name: getattr(self, name) for name in ("feature_names", "classes", *_OPTIONAL)},
            "card": as_plain(self.card),
        }
        FORMAT.write(Path(folder) / self.name, description, arrays)
        return Path(folder) / f"{self.name}.npz"

    @staticmethod
    def load(name_or_path: str | Path, features: FeatureSet | FeatureFunction | None = None) -> ContextModel:
        """Load a shipped model by name, a model by its path, or the only model in a folder.

        Parameters
        ----------
        name_or_path : str or Path
            Name of a shipped model, path of a .npz or .json, or folder.
        features : FeatureSet or callable, optional
            Features that the model was fitted with, if they are not features of this package, because files contain no
            code.

        Returns
        -------
        ContextModel
            The model.

        Raises
        ------
        ValueError
            If a file is missing, damaged, or of another kind. The message names file and remedy.
        """
        path = folder = Path(name_or_path)
        if folder.is_dir():
            names = FORMAT.names_in(folder)
            if len(names) != 1:
                raise ValueError(
                    f"{folder}: the folder has {len(names)} context models, not one: give the path of one (.npz)"
                )
            path = folder / f"{names[0]}.npz"
        model = load_model(path if folder.is_dir() else name_or_path)
        return model if features is None else replace(model, features=feature_set_of(features))

    def report(self) -> str:
        """Return the model card as text: data, people, held-out scores and confusion.

        Returns
        -------
        str
            One fact per line.
        """
        return "\n".join(_card_lines(self.card))


def _card_lines(card: Mapping[str, Any]) -> list[str]:
    """Return the lines of the report of a model card, without facts that the card does not have."""
    n_windows: dict[str, int] = card.get("n_windows", {})
    scores: dict[str, Any] = card.get("leave_one_subject_out", {})
    confusion: dict[str, dict[str, int]] = scores.get("confusion", {})
    lines = [str(card[name]) for name in ("description", "limits") if card.get(name)]
    counts = ", ".join(f"{label} {n}" for label, n in n_windows.items())
    n_people = card.get("n_people")
    of_people = "unknown people" if n_people is None else how_many(n_people, "person", "people")
    lines.append(f"{sum(n_windows.values())} windows of {of_people}: {counts}")
    if "log_loss" in scores:
        held_out = "recordings" if n_people == 1 else "people"
        lines.append(
            f"{held_out} not in training: log loss {scores['log_loss']:.3f}, accuracy {scores['accuracy']:.3f}, macro "
            f"recall {scores['macro_recall']:.3f}, calibration error {scores['expected_calibration_error']:.3f}"
        )
    if "placements" in card:
        lines += _limits_of_data(card)
    if confusion:
        lines.append("confusion, windows of each true label by the most probable one:")
        names = list(next(iter(confusion.values())))
        width = max(map(len, (*names, *confusion)))
        lines.append(" " * width + "".join(f" {name:>{max(len(name), 6)}}" for name in names))
        for truth, row in confusion.items():
            lines.append(f"{truth:>{width}}" + "".join(f" {row[name]:>{max(len(name), 6)}}" for name in names))
    for name in ("transition_prob", "exponents"):
        if name in card:
            lines.append(f"{name}: {card[name]}")
    return lines


def _limits_of_data(card: Mapping[str, Any]) -> list[str]:
    """Return what the numbers of people and placements in the training data mean for other people and placements.

    The accuracies of N held-out people and of a further person are exchangeable, so that each of the N + 1 people is
    the worst with equal probability.
    """
    n_people, worst = card["n_people"], card["leave_one_subject_out"].get("worst_person_accuracy")
    if worst is None:
        of_people = "all recordings are of one person: nothing is known about other people; add recordings of others"
    else:
        of_people = (
            f"the worst of {n_people} people has an accuracy of {worst:.3f}: a further person is worse with a "
            f"probability of about 1 in {n_people + 1}"
        )
    if not card["placements"]:
        return [of_people, "placements of the phone are not labelled: nothing is known about other placements"]
    placements = ", ".join(card["placements"])
    return [of_people, f"placements of the phone in training: {placements}; nothing is known about other placements"]


def blend_stairs_with_prior(prob: FloatArray, share: FloatArray, level_and_stairs: list[int]) -> FloatArray:
    """Return context probabilities (..., C) with walking and stairs partly redistributed by the steps of a usual day.

    Let g be the sum of the probabilities of level walking, stairs up and stairs down. The part `share` g is divided
    among the three in the ratio 0.94 : 0.03 : 0.03. Each of the three keeps 1 - `share` of its own probability. Other
    contexts are unchanged. `share` (...) says how unlike the stairs of the training data each window is, from 0 (alike,
    nothing changes) to 1 (unlike, all of g is redistributed). It is `Assessment.stairs_unknown_share`.
    `level_and_stairs` are the indices of level walking, stairs up and stairs down.
    """
    if not np.any(share):
        return prob
    share, gait = share[..., None], prob[..., level_and_stairs]
    result = prob.copy()
    result[..., level_and_stairs] = (1 - share) * gait + share * gait.sum(axis=-1, keepdims=True) * _DAILY_STEP_SHARES
    return result


def load_model(name_or_path: str | Path) -> ContextModel:
    """Load a shipped model by its name, or any model by its path.

    Parameters
    ----------
    name_or_path : str or Path
        Name of a shipped model, or path of a .npz or .json.

    Returns
    -------
    ContextModel
        The model.

    Raises
    ------
    ValueError
        If a file is missing, damaged, or of another kind. The message names file and remedy.

    Examples
    --------
    >>> from pdr_filter.classifiers.context_model import load_model
    >>> load_model("context").head
    'context'
    """
    path = _find(name_or_path)
    return FORMAT.read(path, _assemble) if path is name_or_path else _shipped_at(path)


@cache
def _shipped_at(path: str | Path) -> ContextModel:
    """Return the shipped model with the files at a path, which are read once, with its checksum."""
    model = FORMAT.read(path, _assemble)
    # The description contains the checksum of the arrays. Its line endings can differ between systems.
    description = file_pair(path)[0].read_text("utf-8")
    object.__setattr__(model, "_checksum", hashlib.sha256(description.encode()).hexdigest())
    return model


def available_models() -> tuple[str, ...]:
    """Return the names of the shipped models, sorted."""
    return tuple(sorted({name for folder in _SHIPPED for name in FORMAT.names_in(folder)}))


def _find(name_or_path: str | Path) -> str | Path:
    """Return the path of the files of a shipped model without suffix, for its name, or a given path unchanged.

    ValueError for a name that no shipped model has.
    """
    text = str(name_or_path)
    is_name = isinstance(name_or_path, str) and not text.endswith((".npz", ".json")) and _NAME.fullmatch(text)
    if not is_name:
        return name_or_path
    path = _shipped_path(text)
    if path is not None:
        return path
    known = ", ".join(available_models()) or "none"
    raise ValueError(f"{text}: no shipped model of that name (there are: {known}): give a name or a path to a .npz")


def _shipped_path(name: str) -> Path | None:
    """Return the path of the files of a shipped model without suffix, or None if there is none of this name."""
    paths = (folder / name for folder in _SHIPPED if _NAME.fullmatch(name))
    return next((path for path in paths if file_pair(path)[0].is_file()), None)


def _assemble(description: Mapping[str, Any], arrays: Arrays) -> ContextModel:
    """Return the model of a file. `FORMAT.read` turns errors of missing or wrong parts into ValueError."""
    kind = description["machine"]
    if kind not in MACHINES:
        raise ValueError(
            f"its classifier (machine) is {kind!r}, which this version does not know; it knows {tuple(MACHINES)}"
        )
    familiarity, stairs = of_prefix(_FAMILIARITY, arrays), of_prefix(_STAIRS, arrays)
    return ContextModel(
        name=description["name"],
        feature_names=description["feature_names"],
        classes=description["classes"],
        **cast(Any, {name: arrays[name] for name in _ARRAYS} | {name: float(arrays[name]) for name in _NUMBERS}),
        **{name: description[name] for name in _OPTIONAL if name in description},
        machine=MACHINES[kind].from_arrays(of_prefix(_MACHINE, arrays)),
        card=dict(description["card"]),
        head=description["head"],
        familiarity=Familiarity.from_arrays(familiarity) if familiarity else None,
        stairs=Familiarity.from_arrays(stairs) if stairs else None,
        transition_prob=arrays.get("transition_prob"),
    )


def _check(model: ContextModel) -> None:
    """Raise ValueError unless the parts of a model fit together."""
    if not _NAME.fullmatch(model.name):
        raise ValueError(
            f"name must be letters, digits, dots and dashes, as it becomes a file name, got {model.name!r}"
        )
    if model.head not in HEADS:
        raise ValueError(f"head must be one of {tuple(HEADS)}, got {model.head!r}")
    for label in model.labels:
        check_name_of_context(label)
    if len(set(model.labels)) < len(model.labels):
        raise ValueError(f"labels must be different names, got {model.labels}")
    n_features, n_classes = len(model.feature_names), len(model.classes)
    are_text = all(isinstance(f, str) for f in cast(Any, model.feature_names))
    if len(set(model.feature_names)) != n_features or not are_text:
        raise ValueError("feature_names must be different strings")
    if len(set(model.classes)) != n_classes or not set(model.classes) <= set(model.labels):
        raise ValueError(f"classes must be different labels out of {model.labels}, got {model.classes}")
    if (model.machine.n_features, model.machine.n_classes) != (n_features, n_classes):
        raise ValueError(
            f"the machine has {model.machine.n_features} features and {model.machine.n_classes} classes, but there are "
            f"{n_features} feature_names and {n_classes} classes: give the names with which it was trained"
        )
    for name in ("feature_mean", "feature_scale"):
        check_array(name, getattr(model, name), shape=(n_features,), remedy="give one for each feature")
    if not (model.feature_scale > _MIN_DIVISOR).all():
        raise ValueError(f"feature_scale must be above {_MIN_DIVISOR}: use 1 for a constant feature")
    if not (_MIN_DIVISOR < model.temperature < np.inf and model.feature_limit > 0):
        raise ValueError(
            "temperature must be positive and finite, and feature_limit positive, got "
            f"{model.temperature} and {model.feature_limit}"
        )
    if not 0 <= model.slip <= 1:
        raise ValueError(f"slip must be a probability, got {model.slip}")
    for name, known in (("familiarity", model.familiarity), ("stairs", model.stairs)):
        if known is not None and known.n_features != n_features:
            raise ValueError(
                f"{name} has {known.n_features} features, but there are {n_features} feature_names: fit it to the "
                "features of the model"
            )
    if model.stairs is not None and model.head != "context":
        raise ValueError(f"stairs is only for a model of contexts, got head {model.head!r}: leave stairs out")
    if model.stairs is not None and not set(model.stairs_labels) <= set(model.labels):
        raise ValueError(
            f"stairs_labels must be among the labels {model.labels}, got {model.stairs_labels}: give the labels of "
            "level walking, stairs up and stairs down, in this order"
        )
    if model.transition_prob is not None:
        check_transition_prob(model.transition_prob, len(model.labels))
    for name in ("evidence_exponent", "prior_exponent"):
        exponent = getattr(model, name)
        if exponent is not None and not 0 <= exponent < np.inf:
            raise ValueError(f"{name} must be finite and not negative, got {exponent}")
    given = model.feature_names if model.features is None else model.features.names
    if missing := sorted(set(model.feature_names) - set(given)):
        raise ValueError(
            f"features must include {missing[:5]}, which the model was fitted with, got {given[:5]}: give the features "
            "used in training"
        )
    prior = model.training_prior
    if prior.shape != (len(model.labels),) or not (prior >= 0).all() or not np.isclose(prior.sum(), 1.0, atol=1e-9):
        raise ValueError(f"training_prior must be {len(model.labels)} probabilities that sum to one, got {prior}")
    seen = tuple(c for c, p in zip(model.labels, prior, strict=True) if p > 0)
    if set(seen) != set(model.classes):
        raise ValueError(
            f"training_prior is positive for {seen}, but the classes are {model.classes}: give a positive prior to "
            "exactly these"
        )
