"""Context models: a trained machine with all that is needed to use it, in files without code.

A model is `<name>.npz` (plain arrays) and `<name>.json` (feature names, classes and the model card: data, date,
versions, metrics). Reading one never unpickles anything, and what is read is checked before it is used.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from pdr_filter.classifiers.base_classifier import Machine
from pdr_filter.classifiers.blend import Blend
from pdr_filter.classifiers.familiarity import Familiarity
from pdr_filter.classifiers.forest import Forest
from pdr_filter.classifiers.kernel_machine import RelevanceVectors
from pdr_filter.classifiers.model_files import Arrays, ArtefactFormat, file_pair, of_prefix, prefixed
from pdr_filter.classifiers.probability_calibration import slipped, tempered
from pdr_filter.classifiers.softmax import SoftmaxRegression
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
    pickled,
    read_only,
)

# Version 2: heads, temperature, limit of the features, familiarity.
FORMAT = ArtefactFormat("context_model", 2, "train it again, or use the version that wrote it")

# Default labels of each kind of model: contexts or carrying modes.
HEADS: dict[str, tuple[str, ...]] = {"context": CONTEXTS, "carrying_mode": CARRYING_MODES}
# Level walking, up and down, of which a model that guards stairs knows the windows on stairs.
STAIRS_LABELS = ("walking", "upstairs", "downstairs")
# Machines by their names in files.
MACHINES: dict[str, type[Machine]] = {
    "blend": Blend,
    "forest": Forest,
    "relevance_vectors": RelevanceVectors,
    "softmax": SoftmaxRegression,
}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")  # also a file name everywhere
_NUMBERS = ("temperature", "slip", "feature_limit")  # stored as arrays of their own names, as are these:
_ARRAYS = ("training_prior", "feature_mean", "feature_scale")
_LEAST = 1e-30  # that divides: what is divided stays a number
# prefixes of the arrays of parts
_MACHINE, _FAMILIARITY, _STAIRS = "machine_", "familiarity_", "stairs_"

# Of the steps of a day: of 6,000 are ten flights of 16 up stairs, and as many down.
_OF_A_DAY = read_only(np.array([0.94, 0.03, 0.03]))

# In a wheel the models are inside the package, in a checkout at the top level.
_PACKAGE = Path(__file__).resolve().parents[1]
_SHIPPED = (_PACKAGE / "models", _PACKAGE.parent / "models")


class Assessment(NamedTuple):
    """What a model says of one window, and what of it is not known."""

    prob: FloatArray  # (L,) of the labels
    unknown_share: float  # how unlike all training windows it is, 0 to 1
    stairs_unknown_share: float  # how unlike all stairs in training; by that share stairs are not told from walking


@dataclass(frozen=True, slots=True, eq=False)
class ContextModel:
    """Features of one window in, calibrated probabilities out.

    Parameters
    ----------
    name : str
        Also the name of its files.
    feature_names : (F,)
        Features in the order that `predict` takes them.
    classes : (K,)
        The labels that the machine distinguishes, a part of `labels`, in the machine's order.
    training_prior : (L,)
        Shares of `labels` in the training data, summing to one; zero for labels that the model has not seen.
    feature_mean, feature_scale : (F,)
        The machine sees (features - mean) / scale; zeros and ones for a forest.
    machine : Machine
        Class probabilities in the order of `classes`.
    card : dict
        What people should know: data, date, versions, metrics. Anything that JSON holds.
    head : {"context", "carrying_mode"}
        What is distinguished.
    temperature : float
        Divides the logits, `probability_calibration.tempered`; fitted on people not in training.
    slip : float
        Probability that a window is something else and any class alike, `probability_calibration.slipped`; fitted with
        the temperature.
    feature_limit : float
        Standardised features are cut at plus and minus this: what training has not seen must not be able to outvote
        everything that it has.
    familiarity : Familiarity, optional
        Knows how far from the training windows a window is; without it nothing is ever unknown.
    stairs : Familiarity, optional
        The same of the training windows on stairs: where a window is like none of them, whatever tells stairs from
        level walking was learnt of other places for the phone, and `not_told_apart` takes its place.
    labels : (L,), optional
        Names in the order of the probabilities. If not given, those of the default: `CONTEXTS` or `CARRYING_MODES`.
    stairs_labels : (3,)
        Labels of level walking, of stairs up and of stairs down that `stairs` is about.
    transition_prob : (L, L), optional
        Between `labels` from one step to the next, estimated from the labels of the training; rows sum to one.
    evidence_exponent, prior_exponent : float, optional
        Of the evidence of a window, as in `PedestrianModel`, chosen on the labels of the training.
    features : FeatureSet, optional
        Computes the features of windows, if they are none of the package's own. Files do not hold it.
    needs_gyroscope : bool
        False if the model learnt from windows without angular rate.

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

    __reduce__ = pickled

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", tuple(self.labels) or HEADS.get(self.head, ()))
        object.__setattr__(self, "feature_names", tuple(self.feature_names))
        object.__setattr__(self, "classes", tuple(self.classes))
        for name in _ARRAYS:
            object.__setattr__(self, name, read_only(getattr(self, name)))
        if self.transition_prob is not None:
            object.__setattr__(self, "transition_prob", read_only(self.transition_prob))
        _check(self)

    @property
    def contexts(self) -> tuple[str, ...]:
        """Names of what the model distinguishes, in the order of the probabilities."""
        return self.labels

    def renamed(self, names: Mapping[str, str]) -> ContextModel:
        """Return a copy with renamed labels; ValueError for a key that is not a label of the model."""
        if unknown := set(names) - set(self.labels):
            raise ValueError(f"no label {', '.join(sorted(unknown))} in {self.labels}: give the present names as keys")
        level, up, down = (names.get(label, label) for label in self.stairs_labels)
        return replace(
            self,
            classes=tuple(names.get(label, label) for label in self.classes),
            labels=tuple(names.get(label, label) for label in self.labels),
            stairs_labels=(level, up, down),
        )

    def predict(self, features: FloatArray) -> FloatArray:
        """Probabilities in the order of `labels`, (L,), summing to one, from the features of one window (F,).

        Labels that the model has not seen get zero. Raises ValueError for NaN, naming the feature.
        """
        return self.assess(features)[0]

    def assess(self, features: FloatArray) -> Assessment:
        """Probabilities as `predict` gives them, and how much is unknown (`Familiarity`)."""
        return self.assess_all(np.asarray(features)[None])[0]

    def assess_all(self, features: FloatArray) -> list[Assessment]:
        """What `assess` says of each of many windows, from their features (W, F): the same bits."""
        values = np.ascontiguousarray(features, dtype=np.float64)  # sums along another axis have other bits
        if values.ndim != 2 or values.shape[1] != len(self.feature_names):
            raise ValueError(
                f"model {self.name!r} takes {len(self.feature_names)} features of a window, got shape "
                f"{values.shape[1:]}"
            )
        finite = np.isfinite(values)
        if not finite.all():
            window, index = np.argwhere(~finite)[0].tolist()
            raise ValueError(
                f"feature {index} ({self.feature_names[index]}) is {values[window, index]}: "
                "leave such windows out or fill in a value"
            )
        standardised = self.standardised(values)
        unknown, unlike_stairs = (
            np.zeros(len(values)) if known is None else known.unknown_share(standardised)
            for known in (self.familiarity, self.stairs)
        )
        prob = not_told_apart(self._of_standardised(standardised), unlike_stairs, self._level_and_stairs)
        prob = prob / prob.sum(axis=1, keepdims=True)
        return [Assessment(*each) for each in zip(prob, unknown.tolist(), unlike_stairs.tolist(), strict=True)]

    def standardised(self, features: FloatArray) -> FloatArray:
        """Features (..., F) as shares of the training windows' spread, not yet cut at the limit."""
        return (features - self.feature_mean) / self.feature_scale

    def probabilities(self, features: FloatArray) -> FloatArray:
        """Probabilities (W, L) of many windows at once, from their features (W, F)."""
        standardised = self.standardised(features)
        prob = self._of_standardised(standardised)
        if self.stairs is None:
            return prob
        return not_told_apart(prob, self.stairs.unknown_share(standardised), self._level_and_stairs)

    @property
    def _level_and_stairs(self) -> list[int]:
        return [] if self.stairs is None else [self.labels.index(label) for label in self.stairs_labels]

    def _of_standardised(self, rows: FloatArray) -> FloatArray:
        cut = np.clip(rows, -self.feature_limit, self.feature_limit)
        prob = np.zeros((len(rows), len(self.labels)))
        known = slipped(tempered(self.machine.predict_proba(cut), self.temperature), self.slip)
        prob[:, [self.labels.index(c) for c in self.classes]] = known
        return prob

    def save(self, folder: str | Path) -> Path:
        """Write `<name>.npz` and `<name>.json` into the folder and return the path of the .npz.

        Features of a function are not written: give the function to `load` again. ValueError for a classifier of
        another library, which says how to keep it.
        """
        arrays: Arrays = {name: np.asarray(getattr(self, name)) for name in (*_ARRAYS, *_NUMBERS)}
        if self.familiarity is not None:
            arrays |= prefixed(_FAMILIARITY, self.familiarity.to_arrays())
        if self.stairs is not None:
            arrays |= prefixed(_STAIRS, self.stairs.to_arrays())
        if self.transition_prob is not None:
            arrays["transition_prob"] = self.transition_prob
        arrays |= prefixed(_MACHINE, self.machine.to_arrays())
        description = {
            "name": self.name,
            "head": self.head,
            "machine": next(kind for kind, cls in MACHINES.items() if isinstance(self.machine, cls)),
            "feature_names": list(self.feature_names),
            "classes": list(self.classes),
            "labels": list(self.labels),
            "stairs_labels": list(self.stairs_labels),
            "needs_gyroscope": self.needs_gyroscope,
            "evidence_exponent": self.evidence_exponent,
            "prior_exponent": self.prior_exponent,
            "card": as_plain(self.card),
        }
        FORMAT.write(Path(folder) / self.name, description, arrays)
        return Path(folder) / f"{self.name}.npz"

    @staticmethod
    def load(name_or_path: str | Path, features: FeatureSet | FeatureFunction | None = None) -> ContextModel:
        """Return a shipped model by its name, the model at a path to its .npz or .json, or the only one in a folder.

        `features` are those that the model was fitted with, if they are none of the package's own: files hold no code.
        ValueError that names the file and the remedy if it is missing, damaged or not what it says.
        """
        path = folder = Path(name_or_path)
        if folder.is_dir():
            names = FORMAT.names_in(folder)
            if len(names) != 1:
                raise ValueError(
                    f"{folder}: {len(names)} context models are in this folder: give the path of a .npz in it"
                )
            path = folder / f"{names[0]}.npz"
        model = load_model(path if folder.is_dir() else name_or_path)
        return model if features is None else replace(model, features=feature_set_of(features))

    def report(self) -> str:
        """Return the card in words: data, people, held-out scores and confusion, one fact a line."""
        return "\n".join(_lines_of(self.card))


def _lines_of(card: Mapping[str, Any]) -> list[str]:
    """Lines of a report of a card; facts that the card does not have are left out."""
    n_windows: dict[str, int] = card.get("n_windows", {})
    scores: dict[str, Any] = card.get("leave_one_subject_out", {})
    confusion: dict[str, dict[str, int]] = scores.get("confusion", {})
    lines = [str(card[name]) for name in ("description", "limits") if card.get(name)]
    counts = ", ".join(f"{label} {n}" for label, n in n_windows.items())
    lines.append(f"{sum(n_windows.values())} windows of {card.get('n_people', 'unknown')} people: {counts}")
    if "log_loss" in scores:
        lines.append(
            f"people not in training: log loss {scores['log_loss']:.3f}, accuracy {scores['accuracy']:.3f}, macro "
            f"recall {scores['macro_recall']:.3f}, calibration error {scores['expected_calibration_error']:.3f}"
        )
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


def not_told_apart(prob: FloatArray, share: FloatArray, level_and_stairs: list[int]) -> FloatArray:
    """Context probabilities (..., C), a share (...) of those of walking and stairs being divided as a day is.

    `level_and_stairs` are the indices of level walking, of up and of down.
    """
    if not np.any(share):
        return prob
    share, gait = share[..., None], prob[..., level_and_stairs]
    result = prob.copy()
    result[..., level_and_stairs] = (1 - share) * gait + share * gait.sum(axis=-1, keepdims=True) * _OF_A_DAY
    return result


def load_model(name_or_path: str | Path) -> ContextModel:
    """Return a shipped model by its name, or the model at a path to its .npz or .json.

    Raises ValueError that names the file and the remedy if it is missing, damaged or not what it says.
    """
    return FORMAT.read(_find(name_or_path), _assemble)


def available_models() -> tuple[str, ...]:
    """Names of the shipped models, sorted."""
    return tuple(sorted({name for folder in _SHIPPED for name in FORMAT.names_in(folder)}))


def _find(name_or_path: str | Path) -> str | Path:
    """Return the path of a model's files, with or without an ending."""
    text = str(name_or_path)
    is_name = isinstance(name_or_path, str) and not text.endswith((".npz", ".json")) and _NAME.fullmatch(text)
    if not is_name:
        return name_or_path
    for folder in _SHIPPED:
        if file_pair(folder / text)[0].is_file():
            return folder / text
    known = ", ".join(available_models()) or "none"
    raise ValueError(f"{text}: no shipped model of that name (there are: {known}); give a name or a path to a .npz")


def _assemble(description: Mapping[str, Any], arrays: Arrays) -> ContextModel:
    """Return the model; KeyError, TypeError or ValueError if anything is missing or does not fit."""
    kind = description["machine"]
    if kind not in MACHINES:
        raise ValueError(f"machine is {kind!r}, not one of {tuple(MACHINES)}")
    familiarity, stairs = of_prefix(_FAMILIARITY, arrays), of_prefix(_STAIRS, arrays)
    return ContextModel(
        name=description["name"],
        feature_names=tuple(description["feature_names"]),
        classes=tuple(description["classes"]),
        **cast(Any, {name: arrays[name] for name in _ARRAYS} | {name: float(arrays[name]) for name in _NUMBERS}),
        machine=MACHINES[kind].from_arrays(of_prefix(_MACHINE, arrays)),
        card=dict(description["card"]),
        head=description["head"],
        familiarity=Familiarity.from_arrays(familiarity) if familiarity else None,
        stairs=Familiarity.from_arrays(stairs) if stairs else None,
        labels=tuple(description.get("labels", ())),
        stairs_labels=tuple(description.get("stairs_labels", STAIRS_LABELS)),
        transition_prob=arrays.get("transition_prob"),
        needs_gyroscope=description.get("needs_gyroscope", True),
        evidence_exponent=description.get("evidence_exponent"),
        prior_exponent=description.get("prior_exponent"),
    )


def _check(model: ContextModel) -> None:
    """Raise ValueError unless the parts of the model fit together."""
    if not _NAME.fullmatch(model.name):
        raise ValueError(f"name {model.name!r} must be letters, digits, dots, dashes: it becomes a file name")
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
            f"the machine has {model.machine.n_features} features and {model.machine.n_classes} classes, "
            f"the names say {n_features} and {n_classes}"
        )
    for name in ("feature_mean", "feature_scale"):
        check_array(name, getattr(model, name), shape=(n_features,), remedy="give one for each feature")
    if not (model.feature_scale > _LEAST).all():
        raise ValueError(f"feature_scale must be above {_LEAST}; use one for a feature that does not vary")
    if not (_LEAST < model.temperature < np.inf and model.feature_limit > 0):
        raise ValueError(
            f"temperature and feature_limit must be positive, got {model.temperature} and {model.feature_limit}"
        )
    if not 0 <= model.slip <= 1:
        raise ValueError(f"slip must be a probability, got {model.slip}")
    for name, known in (("familiarity", model.familiarity), ("stairs", model.stairs)):
        if known is not None and known.axes.shape[1] != n_features:
            raise ValueError(f"{name} is of {known.axes.shape[1]} features, the names say {n_features}")
    if model.stairs is not None and model.head != "context":
        raise ValueError(f"stairs are a context, the model classifies the {model.head}")
    if model.stairs is not None and not set(model.stairs_labels) <= set(model.labels):
        raise ValueError(f"stairs_labels must be three of {model.labels}, got {model.stairs_labels}")
    if model.transition_prob is not None:
        check_transition_prob(model.transition_prob, len(model.labels))
    for name in ("evidence_exponent", "prior_exponent"):
        exponent = getattr(model, name)
        if exponent is not None and not 0 <= exponent < np.inf:
            raise ValueError(f"{name} must be finite and not negative, got {exponent}")
    given = model.feature_names if model.features is None else model.features.names
    if missing := sorted(set(model.feature_names) - set(given)):
        raise ValueError(
            f"features must have {missing[:5]}, which the model was fitted with, got {given[:5]}: give the features of "
            "the training"
        )
    prior = model.training_prior
    if prior.shape != (len(model.labels),) or not (prior >= 0).all() or not np.isclose(prior.sum(), 1.0, atol=1e-9):
        raise ValueError(f"training_prior must be {len(model.labels)} probabilities that sum to one, got {prior}")
    seen = tuple(c for c, p in zip(model.labels, prior, strict=True) if p > 0)
    if set(seen) != set(model.classes):
        raise ValueError(f"training_prior is positive for {seen}, but the classes are {model.classes}")
