"""Context models: a trained machine with all that is needed to use it, in files without code.

A model is `<name>.npz` (plain arrays) and `<name>.json` (feature names, classes and the model card: data, date,
versions, metrics). Reading one never unpickles anything, and what is read is checked before it is used.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pdr_filter.classifiers.blend import Blend
from pdr_filter.classifiers.familiarity import Familiarity
from pdr_filter.classifiers.forest import Forest
from pdr_filter.classifiers.kernel_machine import RelevanceVectors
from pdr_filter.classifiers.probability_calibration import slipped, tempered
from pdr_filter.classifiers.softmax import SoftmaxRegression
from pdr_filter.values.arrays import FloatArray, read_only
from pdr_filter.values.contexts import CARRYING_MODES, CONTEXTS

FORMAT_VERSION = 2  # 2: heads, temperature, limit of the features, familiarity

# What a model tells apart: the activity, or where the phone is.
HEADS: dict[str, tuple[str, ...]] = {"context": CONTEXTS, "carrying_mode": CARRYING_MODES}

Machine = Blend | Forest | RelevanceVectors | SoftmaxRegression

_MACHINES: dict[str, type[Blend] | type[Forest] | type[RelevanceVectors] | type[SoftmaxRegression]] = {
    "blend": Blend,
    "forest": Forest,
    "relevance_vectors": RelevanceVectors,
    "softmax": SoftmaxRegression,
}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")  # also a file name everywhere
_MACHINE_PREFIX = "machine_"  # of the machine's arrays in the .npz
_FAMILIARITY_PREFIX = "familiarity_"

# In a wheel the models are inside the package, in a checkout at the top level.
_PACKAGE = Path(__file__).resolve().parents[1]
_SHIPPED = (_PACKAGE / "models", _PACKAGE.parent / "models")


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
        The labels that the machine tells apart, a part of `labels`, in the machine's order.
    training_prior : (L,)
        Shares of `labels` in the training data, summing to one; zero for labels that the model has not seen.
    feature_mean, feature_scale : (F,)
        The machine sees (features - mean) / scale; zeros and ones for a forest.
    machine : Blend, Forest, RelevanceVectors or SoftmaxRegression
        Class probabilities in the order of `classes`.
    card : dict
        What people should know: data, date, versions, metrics. Anything that JSON holds.
    head : {"context", "carrying_mode"}
        What is told apart.
    temperature : float
        Divides the logits, `calibration.tempered`; fitted on people not in training.
    slip : float
        Probability that a window is something else and any class alike, `calibration.slipped`; fitted with it.
    feature_limit : float
        Standardised features are cut at plus and minus this: what training has not seen must not be able to outvote
        everything that it has.
    familiarity : Familiarity, optional
        Knows how far from the training windows a window is; without it nothing is ever unknown.
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

    def __post_init__(self) -> None:
        object.__setattr__(self, "feature_names", tuple(self.feature_names))
        object.__setattr__(self, "classes", tuple(self.classes))
        for name in ("training_prior", "feature_mean", "feature_scale"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        _check(self)

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels in the order of `predict`: `CONTEXTS` or `CARRYING_MODES`."""
        return HEADS[self.head]

    def predict(self, features: FloatArray) -> FloatArray:
        """Probabilities in the order of `labels`, (L,), summing to one, from the features of one window (F,).

        Labels that the model has not seen get zero. Raises ValueError for NaN, naming the feature.
        """
        return self.assess(features)[0]

    def assess(self, features: FloatArray) -> tuple[FloatArray, float]:
        """Probabilities as `predict` gives them, and the share of them that is unknown, 0 to 1.

        The share says how far outside of what the model was trained on the window is (`Familiarity`); the
        probabilities do not yet take it into account.
        """
        values = np.asarray(features, dtype=np.float64)
        if values.shape != (len(self.feature_names),):
            raise ValueError(
                f"model {self.name!r} takes {len(self.feature_names)} features of one window, got shape {values.shape}"
            )
        finite = np.isfinite(values)
        if not finite.all():
            index = int(np.argmin(finite))
            raise ValueError(
                f"feature {index} ({self.feature_names[index]}) is {values[index]}: "
                "leave such windows out or fill in a value"
            )
        standardised = (values - self.feature_mean) / self.feature_scale
        unknown = 0.0 if self.familiarity is None else self.familiarity.unknown_share(standardised)
        cut = np.clip(standardised, -self.feature_limit, self.feature_limit)
        prob = np.zeros(len(self.labels))
        known = slipped(tempered(self.machine.predict_proba(cut[None])[0], self.temperature), self.slip)
        prob[[self.labels.index(c) for c in self.classes]] = known
        return prob / prob.sum(), unknown

    def save(self, folder: str | Path) -> Path:
        """Write `<name>.npz` and `<name>.json` into the folder and return the path of the .npz."""
        arrays: dict[str, NDArray[Any]] = {
            "training_prior": self.training_prior,
            "feature_mean": self.feature_mean,
            "feature_scale": self.feature_scale,
            "temperature": np.array(self.temperature),
            "slip": np.array(self.slip),
            "feature_limit": np.array(self.feature_limit),
        }
        if self.familiarity is not None:
            arrays |= {_FAMILIARITY_PREFIX + name: array for name, array in self.familiarity.to_arrays().items()}
        arrays |= {_MACHINE_PREFIX + name: array for name, array in self.machine.to_arrays().items()}
        buffer = io.BytesIO()
        np.savez_compressed(buffer, allow_pickle=False, **cast(Any, arrays))
        content = buffer.getvalue()
        description = {
            "format_version": FORMAT_VERSION,
            "name": self.name,
            "head": self.head,
            "machine": next(kind for kind, cls in _MACHINES.items() if isinstance(self.machine, cls)),
            "feature_names": list(self.feature_names),
            "classes": list(self.classes),
            # Files of two trainings have the same names and shapes: only this tells that they do not belong together.
            "npz_sha256": hashlib.sha256(content).hexdigest(),
            "card": self.card,
        }
        text = json.dumps(description, indent=2, ensure_ascii=False, default=_plain) + "\n"
        target = Path(folder)
        target.mkdir(parents=True, exist_ok=True)
        (target / f"{self.name}.npz").write_bytes(content)
        (target / f"{self.name}.json").write_text(text, encoding="utf-8")
        return target / f"{self.name}.npz"


def load_model(name_or_path: str | Path) -> ContextModel:
    """Return a shipped model by its name, or the model at a path to its .npz or .json.

    Raises ValueError that names the file and the remedy if it is missing, damaged or not what it says.
    """
    stem = _find(name_or_path)
    npz_path, json_path = Path(f"{stem}.npz"), Path(f"{stem}.json")
    for path in (npz_path, json_path):
        if not path.is_file():
            raise ValueError(f"{path}: no such file; a model is a .npz and a .json of the same name in one folder")
    description = _read_description(json_path)
    content = npz_path.read_bytes()
    if hashlib.sha256(content).hexdigest() != description.get("npz_sha256"):
        raise ValueError(
            f"{npz_path}: not the arrays that {json_path.name} was written with (damaged, or from another training); "
            "copy both files again"
        )
    try:
        return _assemble(description, _read_arrays(content))
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        what = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise ValueError(f"{npz_path}: not a usable context model: {what}; train and save it again") from error


def available_models() -> tuple[str, ...]:
    """Names of the shipped models, sorted."""
    found = {path.stem for folder in _SHIPPED for path in folder.glob("*.npz") if _is_context_model(path)}
    return tuple(sorted(found))


def _is_context_model(path: Path) -> bool:
    """Whether there is a card, and not that of a calibration, which people may keep in the same folder."""
    card = path.with_suffix(".json")
    return card.is_file() and json.loads(card.read_text(encoding="utf-8")).get("kind") != "calibration"


def _find(name_or_path: str | Path) -> Path:
    """Return the path of a model's files without their ending."""
    text = str(name_or_path)
    stem = re.sub(r"\.(npz|json)$", "", text)
    is_name = isinstance(name_or_path, str) and stem == text and _NAME.fullmatch(text) is not None
    if not is_name:
        return Path(stem)
    for folder in _SHIPPED:
        if (folder / f"{text}.npz").is_file():
            return folder / text
    known = ", ".join(available_models()) or "none"
    raise ValueError(f"{text}: no shipped model of that name (there are: {known}); give a name or a path to a .npz")


def _read_description(path: Path) -> dict[str, Any]:
    """Return the content of the .json; ValueError if it is damaged or of another format."""
    try:
        description: Any = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not valid JSON ({error}); copy the model's files again") from error
    version = cast(dict[str, Any], description).get("format_version") if isinstance(description, dict) else None
    if version != FORMAT_VERSION:
        raise ValueError(
            f"{path}: format_version is {version}, this version reads {FORMAT_VERSION}; "
            "train the model again or use the version that wrote it"
        )
    return description


def _read_arrays(content: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of a .npz; ValueError if it is damaged or holds anything but plain arrays."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except (OSError, EOFError, AttributeError, TypeError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"not plain arrays ({error})") from error


def _assemble(description: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> ContextModel:
    """Return the model; KeyError, TypeError or ValueError if anything is missing or does not fit."""
    kind = description["machine"]
    if kind not in _MACHINES:
        raise ValueError(f"machine is {kind!r}, not one of {tuple(_MACHINES)}")

    def starting_with(prefix: str) -> dict[str, NDArray[Any]]:
        return {name.removeprefix(prefix): a for name, a in arrays.items() if name.startswith(prefix)}

    familiarity = starting_with(_FAMILIARITY_PREFIX)
    return ContextModel(
        name=description["name"],
        feature_names=tuple(description["feature_names"]),
        classes=tuple(description["classes"]),
        training_prior=arrays["training_prior"],
        feature_mean=arrays["feature_mean"],
        feature_scale=arrays["feature_scale"],
        machine=_MACHINES[kind].from_arrays(starting_with(_MACHINE_PREFIX)),
        card=dict(description["card"]),
        head=description["head"],
        temperature=float(arrays["temperature"]),
        slip=float(arrays["slip"]),
        feature_limit=float(arrays["feature_limit"]),
        familiarity=Familiarity.from_arrays(familiarity) if familiarity else None,
    )


def _check(model: ContextModel) -> None:
    """Raise ValueError unless the parts of the model fit together."""
    if not _NAME.fullmatch(model.name):
        raise ValueError(f"name {model.name!r} must be letters, digits, dots, dashes: it becomes a file name")
    if model.head not in HEADS:
        raise ValueError(f"head must be one of {tuple(HEADS)}, got {model.head!r}")
    n_features, n_classes = len(model.feature_names), len(model.classes)
    if len(set(model.feature_names)) != n_features or not all(
        isinstance(f, str) for f in cast(Any, model.feature_names)
    ):
        raise ValueError("feature_names must be different strings")
    if len(set(model.classes)) != n_classes or not set(model.classes) <= set(model.labels):
        raise ValueError(f"classes must be different labels out of {model.labels}, got {model.classes}")
    if (model.machine.n_features, model.machine.n_classes) != (n_features, n_classes):
        raise ValueError(
            f"the machine has {model.machine.n_features} features and {model.machine.n_classes} classes, "
            f"the names say {n_features} and {n_classes}"
        )
    if model.feature_mean.shape != (n_features,) or model.feature_scale.shape != (n_features,):
        raise ValueError(f"feature_mean and feature_scale must be ({n_features},), one entry for each feature")
    if not (np.isfinite(model.feature_mean).all() and np.isfinite(model.feature_scale).all()):
        raise ValueError("feature_mean and feature_scale must be finite")
    if not (model.feature_scale > 0).all():
        raise ValueError("feature_scale must be positive; use one for a feature that does not vary")
    if not (np.isfinite(model.temperature) and model.temperature > 0 and model.feature_limit > 0):
        raise ValueError(
            f"temperature and feature_limit must be positive, got {model.temperature} and {model.feature_limit}"
        )
    if not 0 <= model.slip <= 1:
        raise ValueError(f"slip must be a probability, got {model.slip}")
    if model.familiarity is not None and model.familiarity.axes.shape[1] != n_features:
        raise ValueError(f"familiarity is of {model.familiarity.axes.shape[1]} features, the names say {n_features}")
    prior = model.training_prior
    if prior.shape != (len(model.labels),) or not (prior >= 0).all() or not np.isclose(prior.sum(), 1.0, atol=1e-9):
        raise ValueError(f"training_prior must be {len(model.labels)} probabilities that sum to one, got {prior}")
    seen = tuple(c for c, p in zip(model.labels, prior, strict=True) if p > 0)
    if set(seen) != set(model.classes):
        raise ValueError(f"training_prior is positive for {seen}, but the classes are {model.classes}")


def _plain(value: Any) -> Any:
    """Return NumPy numbers and arrays of a card as what JSON holds."""
    if isinstance(value, np.generic | np.ndarray):
        return cast(Any, value).tolist()
    raise TypeError(f"the model card holds a {type(value).__name__}, which JSON cannot; make it a number or a string")
