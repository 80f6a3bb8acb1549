"""Files of trained models and calibrations, without code: `<name>.json`, and `<name>.npz` for arrays.

The .json contains the kind, the version of the format, and a checksum of the .npz, which contains plain arrays. Reading
never unpickles anything. All errors of a file are ValueErrors that name the file and the remedy.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from pdr_filter.values import check_whole, limits
from pdr_filter.values.safe_files import read_small, write_files

Arrays = dict[str, NDArray[Any]]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class ArtefactFormat:
    """Kind of artefact, such as a context model, a calibration or a radio map, with the version of its file format."""

    kind: str  # name of the kind, in the .json and in messages
    version: int  # version that is written, and the only one that is read
    remedy: str  # end of the message about a file that cannot be used

    def write(self, path: str | Path, description: Mapping[str, Any], arrays: Arrays | None = None) -> None:
        """Write `<path>.json`, and `<path>.npz` if there are arrays.

        TypeError, before anything is written, for a description that JSON cannot represent. ValueError for NaN, which
        JSON cannot represent either, and for more data than `read` accepts.
        """
        content: dict[str, Any] = {"format_version": self.version, "kind": self.kind, **description}
        packed = None if arrays is None else _packed(arrays)
        if packed is not None:
            # The checksum detects a .json and a .npz of different trainings, which have the same names and shapes.
            content["npz_sha256"] = hashlib.sha256(packed).hexdigest()
        text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False, default=_plain) + "\n"
        n_bytes, n_text = sum(array.nbytes for array in (arrays or {}).values()), len(text.encode())
        if n_bytes > limits.MAX_UNPACKED_BYTES or n_text > limits.MAX_DESCRIPTION_BYTES:
            raise ValueError(
                f"{self.kind} has {n_bytes} bytes of arrays and {n_text} of text, but at most "
                f"{limits.MAX_UNPACKED_BYTES} and {limits.MAX_DESCRIPTION_BYTES} can be read: make it smaller"
            )
        json_path, npz_path = file_pair(path)
        write_files({json_path: text.encode(), **({} if packed is None else {npz_path: packed})})

    def read(self, path: str | Path, build: Callable[[dict[str, Any], Arrays], T]) -> T:
        """Return the object that `build` creates from the description and the arrays.

        There are no arrays if the .json has no checksum of a .npz. ValueError if a file is missing, damaged, or of
        another kind or version, if `build` fails, or if a field of its result is not of its declared type.
        """
        json_path, npz_path = file_pair(path)
        noun = self.kind.replace("_", " ")
        if Path(path).suffix not in (".json", ".npz") and Path(path).is_file():
            raise ValueError(f"{path}: not usable as {noun}, which is a file .json with a file .npz; {self.remedy}")
        for needed in (npz_path if str(path).endswith(".npz") else json_path, json_path):
            if not needed.is_file():
                raise ValueError(f"{needed}: no such file; correct the path, or copy the file there")
        try:
            description = self._checked(read_small(json_path, limits.MAX_DESCRIPTION_BYTES).decode())
            checksum = description.get("npz_sha256")
            built = build(description, {} if checksum is None else _unpacked(npz_path, checksum))
            check_whole(built)
            return built
        except Exception as error:  # a damaged file can raise any exception
            what = f"{error} is missing" if isinstance(error, KeyError) else str(error)
            raise ValueError(f"{json_path}: not usable as {noun}: {what}; {self.remedy}") from error

    def is_at(self, path: str | Path) -> bool:
        """True if a file states that it is of this kind. False if it does not, cannot be read, or is not JSON.

        Other errors of the file are found by `read`.
        """
        try:
            return _kind(json.loads(read_small(file_pair(path)[0], limits.MAX_DESCRIPTION_BYTES))) == self.kind
        except (OSError, ValueError):
            return False

    def names_in(self, folder: Path) -> list[str]:
        """Return the names, without suffix, of the artefacts of this kind in a folder.

        Files of other kinds are ignored. ValueError names a file with the suffix .json that does not contain JSON.
        """
        names: list[str] = []
        for path in folder.glob("*.json"):
            try:
                kind = _kind(json.loads(path.read_text("utf-8")))
            except ValueError as error:
                raise ValueError(f"{path}: no JSON ({error}); move it to another folder") from error
            if kind == self.kind:
                names.append(path.stem)
        return names

    def _checked(self, text: str) -> dict[str, Any]:
        """Return the content of a .json from its text. ValueError if it is of another kind or version."""
        description: Any = json.loads(text)
        if _kind(description) != self.kind:
            raise ValueError(f"its kind is {_kind(description)!r}, not {self.kind!r}")
        if description.get("format_version") != self.version:
            raise ValueError(
                f"its format_version is {description.get('format_version')}, this version reads {self.version} only"
            )
        return description


def file_pair(path: str | Path) -> tuple[Path, Path]:
    """Return the paths of the .json file and the .npz file of one saved model.

    `path` may be the path of either file, or their common path without suffix.
    """
    stem = re.sub(r"\.(npz|json)$", "", str(path))
    return Path(f"{stem}.json"), Path(f"{stem}.npz")


def with_prefix(prefix: str, arrays: Arrays) -> Arrays:
    """Return arrays with a prefix before their names."""
    return {prefix + name: array for name, array in arrays.items()}


def of_prefix(prefix: str, arrays: Arrays) -> Arrays:
    """Return the arrays whose names have a prefix, without the prefix: the inverse of `with_prefix`."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _kind(description: Any) -> Any:
    """Return the kind of artefact that the content of a .json file states, or None if it describes something else.

    Context models of early versions do not state their kind, but have a checksum of their arrays.
    """
    if not isinstance(description, dict):
        return None
    found = cast(dict[str, Any], description)
    return found.get("kind", "context_model" if "npz_sha256" in found else None)


def _packed(arrays: Arrays) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **cast(Any, arrays))
    return buffer.getvalue()


def _unpacked(path: Path, checksum: str) -> Arrays:
    """Return the arrays of a .npz file.

    ValueError if it is missing, too large or damaged, if its checksum differs, or if it contains pickled objects.
    """
    if not path.is_file():
        raise ValueError(f"{path.name} is missing in the same folder, copy both files")
    content = read_small(path, limits.MAX_WHOLE_BYTES)
    if hashlib.sha256(content).hexdigest() != checksum:
        raise ValueError(f"{path.name} is damaged or belongs to another .json, copy both files again")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            claimed = sum(info.file_size for info in archive.infolist())
        if claimed > limits.MAX_UNPACKED_BYTES:
            raise ValueError(f"it claims {claimed} bytes of arrays, more than {limits.MAX_UNPACKED_BYTES}")
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except Exception as error:  # a damaged zip file can raise any exception
        raise ValueError(f"{path.name} cannot be read as plain arrays ({error})") from error


def _plain(value: Any) -> Any:
    """Return a NumPy number or array as a number or list for JSON. TypeError for any other object."""
    if isinstance(value, np.generic | np.ndarray):
        return cast(Any, value).tolist()
    raise TypeError(f"JSON cannot hold a {type(value).__name__}, {str(value)[:60]}; make it a number or a string")
