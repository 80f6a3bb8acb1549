"""Files of a step-length calibration: NAME.json (description) and NAME.npz (arrays)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from pdr_filter.classifiers.model_files import Arrays, ArtefactFormat, file_pair, of_prefix, with_prefix
from pdr_filter.filter.step_length import models as step_length
from pdr_filter.filter.step_length.calibration_result import ARRAYS, CalibrationResult
from pdr_filter.filter.step_length.models import StepLengthModel
from pdr_filter.values import table

FORMAT = ArtefactFormat("calibration", 1, "calibrate again, or use the version that wrote it")
_SEGMENT = "segment_"  # prefix of the column names of `segments` in a file
# Name, context and step-length model of each mode of a configuration.
OwnModels = Sequence[tuple[str, str, StepLengthModel]]


def write_calibration(path: str | Path, result: CalibrationResult) -> Path:
    """Write a calibration, and return the path of the .json file."""
    arrays = {name: np.asarray(getattr(result, name)) for name in ARRAYS}
    columns = result.segments.dtype.names or ()
    arrays |= with_prefix(_SEGMENT, {name: np.asarray(result.segments[name]) for name in columns})
    description = {
        "models": {name: _model_to_plain(model) for name, model in result.models.items()},
        "subject_ids": list(result.subject_ids),
        "residual_std_m": dict(result.residual_std_m),
        "recording_std": result.recording_std,
        "n_segments": dict(result.n_segments),
        "notes": list(result.notes),
        "card": dict(result.card or {}),
        "mode_contexts": dict(result.mode_contexts),
    }
    FORMAT.write(path, description, arrays)
    return file_pair(path)[0]


def values_of(description: Mapping[str, Any], arrays: Arrays, own: OwnModels) -> dict[str, Any]:
    """Return the fields of a calibration from the contents of its files. `FORMAT.read` turns errors into ValueError."""
    return dict(
        models={name: _model_from_plain(name, m, own) for name, m in description["models"].items()},
        **cast(Any, {name: arrays[name] for name in ARRAYS}),
        subject_ids=tuple(description["subject_ids"]),
        residual_std_m=description["residual_std_m"],
        recording_std=float(description["recording_std"]),
        n_segments=description["n_segments"],
        segments=table(of_prefix(_SEGMENT, arrays)),
        notes=tuple(description["notes"]),
        card=description["card"],
        mode_contexts=description.get("mode_contexts", {}),
    )


def is_shipped(model: StepLengthModel) -> bool:
    """Return True for step-length models of this package, whose class names are stored in files."""
    return getattr(step_length, type(model).__name__, None) is type(model)


def _model_to_plain(model: StepLengthModel) -> dict[str, Any]:
    if not is_shipped(model):
        return {"class": None, "n_params": model.n_params}
    # JSON has no infinity
    values = {f.name: getattr(model, f.name) for f in fields(cast(Any, model))}
    return {"class": type(model).__name__, **{name: None if v == np.inf else v for name, v in values.items()}}


def _model_from_plain(context: str, plain: Mapping[str, Any], own: OwnModels) -> StepLengthModel:
    if plain["class"] is None:
        return _model_of(context, plain["n_params"], own)
    kind = getattr(step_length, str(plain["class"]), None)
    if not (isinstance(kind, type) and is_dataclass(kind) and hasattr(kind, "n_params")):
        raise ValueError(
            f"no step-length model {plain['class']!r}: the file was written by another "
            "version of pdr_filter; calibrate again"
        )
    values = {name: np.inf if v is None else float(v) for name, v in plain.items() if name != "class"}
    return cast(StepLengthModel, kind(**values))


def _model_of(context: str, n_params: Any, own: OwnModels) -> StepLengthModel:
    """Return the step-length model of a context from `own`, because the calibration file does not contain it.

    A file names the classes of this package (`is_shipped`). Of a user's own class it has only the number of parameters,
    `n_params`. ValueError unless `own` has a model of such a class, with that number, for the context.
    """
    named = [m for name, _, m in own if name == context] or [m for _, of, m in own if of == context]
    model = named[0] if named else None
    if model is None or is_shipped(model) or model.n_params != n_params:
        raise ValueError(
            f"the step-length model of {context} has a class outside of pdr_filter, "
            f"with {n_params} parameters: pass the "
            "configuration with this model, config.with_step_length(...)"
        )
    return model
