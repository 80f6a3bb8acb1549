"""Files of one recording, from a zip file, a folder or one file, read within bounds whatever the file claims."""

from __future__ import annotations

import codecs
import gzip
import io
import json
import re
import struct
import tomllib
import zipfile
import zlib
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO, Any, cast

from pdr_filter.data.io.column_names import ACCELERATION, LINEAR, quantity_of_file, trial_of
from pdr_filter.values import limits
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.safe_files import inside, open_regular, read_small

# zipfile bounds what it unpacks at once for these two only; a few kilobytes of bzip2 or lzma can become gigabytes.
SUPPORTED_COMPRESSION = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# Errors of zipfile for damaged files.
_PYTHON_ERRORS = (EOFError, RuntimeError, OSError, OverflowError, LookupError, ValueError)
_ZIP_ERRORS = (zipfile.BadZipFile, zlib.error, struct.error, *_PYTHON_ERRORS)
# Files that are recordings by themselves and are read in place, not out of a zip.
IN_PLACE = (".hdf5", ".h5", ".mat", ".xlsx", ".xls", ".mcap", ".db3")
_ZIP, _GZIP = b"PK", b"\x1f\x8b"
# First bytes of files that are given by mistake, with the kind and the remedy.
_OTHERS = {
    b"7z\xbc\xaf": "a 7z archive; unpack it and give the folder",
    b"Rar!": "a rar archive; unpack it and give the folder",
    b"BZh": "a bz2 archive; unpack it and give what is in it",
    b"\xfd7zXZ": "an xz archive; unpack it and give what is in it",
    b"\x28\xb5\x2f\xfd": "a zstd archive; unpack it and give what is in it",
    b"%PDF": "a PDF; export the samples as CSV",
    b"<!doctype html": "a web page; download the file itself, signed in if need be",
    b"<html": "a web page; download the file itself, signed in if need be",
    b"version https://git-lfs": "a pointer to a file in git LFS; get the file itself with git lfs pull",
}
_ABOUT = re.compile(r"(?i)(readme|licen[cs]e|notes?)[^/]*$|\.(md|pdf|html?|png|jpe?g|docx?|mp4|m4a)$|(^|/)\.[^/]*$")
_TABLES = (".csv", ".txt", ".tsv", ".log", ".dat", ".json", ".jsonl", ".ndjson")
LOCATIONS = {"gps", "gnss", "location", "locations"}
# Further words of folder names that are of a sensor, or of what belongs to all sensors, and not of a trial.
_BESIDE = LOCATIONS | {"metadata", "annotation", "annotations", "pedometer", "steps", "heading"}
_OF_KINDS = {"raw", "uncal", "game"}
_TAR_AT, _TAR, _BEGIN_BYTES = 257, b"ustar", 512
_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


class Members:
    """Files of one recording: in a zip file or a folder, or a single file, also in a gz file.

    Nothing is unpacked to disk. Text in UTF-16 with a byte order mark becomes UTF-8. `inside` selects one recording of
    several: a folder or file of a zip file, a session of a log, or the trial `walk1` among files such as
    `walk1_acc.csv`. If each sensor has a folder, a file such as `Accelerometer/data.csv` is `Accelerometer.csv` here,
    and one of several such as `Accelerometer/walk1.csv` is `walk1_Accelerometer.csv`.
    """

    def __init__(
        self, path: Path, archive: zipfile.ZipFile | None = None, inside: str = "", is_gzip: bool = False
    ) -> None:
        self.path = path / inside if inside else path
        self.inside = inside
        self._folder = path if path.is_dir() else None
        self.is_container = archive is not None or self._folder is not None  # not one file
        self._archive = archive
        self._infos = {} if archive is None else _infos_by_name(path, archive)
        self._n_read = 0
        self._most, self._most_of_one = limits.MAX_READ_BYTES, limits.MAX_MEMBER_BYTES
        self._open = gzip.open if is_gzip else open_regular
        if is_gzip:
            self._most = min(self._most, most_unpacked(path.stat().st_size))
        name = path.stem if is_gzip and path.suffix.lower() == ".gz" else path.name
        self._files = _files_below(path) if self._folder else {name: path}
        names = list(self._files if archive is None else self._infos)  # with forward slashes
        flat = _without_sensor_folders(names)
        if inside and self.is_container:
            of_trial = [name for name in names if _path_of_trial(flat.get(name, name)) == inside]
            named = [name for name in names if name == inside or name.startswith(f"{inside}/")]
            names = named or of_trial
            self.is_container = names != [inside]
            if not names:
                raise RecordingError(f"{path}: nothing in it is called {inside}; look into it for the names")
            flat = _without_sensor_folders(named) if named else flat
        self._files = {flat.get(name, name): file for name, file in self._files.items()}
        self._infos = {flat.get(name, name): info for name, info in self._infos.items()}
        self.names = tuple(sorted(flat.get(name, name) for name in names))

    def version(self) -> tuple[tuple[str, int, int], ...]:
        """Return name, size and time of change of each file of a folder."""
        found = {name: file.lstat() for name, file in sorted(self._files.items())}
        return tuple((name, about.st_size, about.st_mtime_ns) for name, about in found.items())

    def read_in_parts(self, names: Sequence[str]) -> Callable[[], float]:
        """Accept files of any length, which are not held in memory; return a function of the fraction read of some."""
        if self._open is not gzip.open:
            self._most = self._most_of_one = limits.MAX_PARTS_BYTES
        sizes = [self._files[n].stat().st_size if self._archive is None else self._infos[n].file_size for n in names]
        before, n_bytes = self._n_read, max(sum(sizes), 1)
        return lambda: min((self._n_read - before) / n_bytes, 1.0)

    def where(self, name: str) -> str:
        """Return the name of a member for messages."""
        return f"{self.path}" if self.path.name == name else f"{self.path}: {name}"

    def only_text(self) -> str:
        """Return the name of the only file that can be a log or a table. RecordingError if there is not one."""
        names = [name for name in self.names if name.lower().endswith((".txt", ".log", ".csv"))] or list(self.names)
        if len(names) != 1:
            raise RecordingError(
                f"{self.path}: {len(names)} files may be the log or table ({', '.join(names[:4]) or 'nothing'}); "
                "give the path of one log or table"
            )
        return names[0]

    def head(self, name: str, most: int = limits.HEAD_BYTES) -> bytes:
        """Return the first `most` bytes of a file."""
        return next(self._parts(name, most, limits.MAX_PARTS_BYTES), b"")

    def small(self, name: str) -> bytes:
        """Return the bytes of a file that is small in every recording. RecordingError if it is large."""
        return self.whole(name, limits.MAX_SMALL_BYTES, "take out of it what is not needed")

    def whole(self, name: str, most: int, remedy: str = "cut the recording") -> bytes:
        """Return the bytes of a file that must be read as a whole. RecordingError if there are more than `most`."""
        parts: list[bytes] = []
        n_bytes = 0
        for part in self.parts(name, min(limits.BLOCK_BYTES, most + 1)):
            parts.append(part)
            n_bytes += len(part)
            if n_bytes > most:
                raise RecordingError(f"{self.where(name)}: more than {most} bytes; {remedy}")
        return b"".join(parts)

    def file(self, most: int) -> bytes:
        """Return the bytes of the opened file. For a zip file, also one inside another, these are the packed bytes."""
        if self._archive is None or self._archive.fp is None:
            return self.whole(self.names[0], most)
        self._archive.fp.seek(0)
        content = self._archive.fp.read(most + 1)
        if len(content) > most:
            raise RecordingError(f"{self.path}: the file has more than {most} bytes; cut the recording")
        return content

    def pieces(self, name: str) -> Iterator[bytes]:
        """Yield a text file in pieces, which may end anywhere in a line. RecordingError for a binary file."""
        for i, part in enumerate(self.parts(name)):
            # UTF-16 without byte order mark, UTF-32 and binary files have zero bytes
            if i == 0 and b"\x00" in part[:4096]:
                raise RecordingError(
                    f"{self.where(name)}: not UTF-8 text but UTF-16 or a binary file; save it as UTF-8"
                )
            yield part.removeprefix(b"\xef\xbb\xbf") if i == 0 else part

    def blocks(self, name: str) -> Iterator[bytes]:
        """Yield a text in blocks of complete lines, which end in line feeds. The last line may lack its line feed."""
        rest = b""
        for part in self.pieces(name):
            if b"\r" in part or rest.endswith(b"\r"):
                part, rest = rest + part, b""
                last = b"\r" if part.endswith(b"\r") else b""  # the line feed may be in the next piece
                part = part.removesuffix(last).replace(b"\r\n", b"\n").replace(b"\r", b"\n") + last
            cut = part.rfind(b"\n") + 1
            block, rest = (rest + part[:cut], part[cut:]) if cut else (b"", rest + part)
            if len(rest) > limits.MAX_LINE_BYTES:
                raise RecordingError(
                    f"{self.where(name)}: a line has more than {limits.MAX_LINE_BYTES} bytes, so the file is no table; "
                    "give a table of samples"
                )
            if block:
                yield block
        if rest:
            yield rest.replace(b"\r", b"\n")

    def parts(self, name: str, size: int | None = None) -> Iterator[bytes]:
        """Yield the bytes of a file in parts of `size` bytes (`BLOCK_BYTES`), so that no more is unpacked at once.

        RecordingError if the file is damaged, encrypted or too large.
        """
        yield from self._parts(name, limits.BLOCK_BYTES if size is None else size, self._most_of_one)

    def _parts(self, name: str, size: int, most: int) -> Iterator[bytes]:
        """Yield the bytes of a file that has at most `most` bytes, in parts."""
        where = self.where(name)
        try:
            if self._archive is None:
                file = self._files[name]
                _check_size(where, file.stat().st_size, most)
                opened = self._open(inside(file, self._folder) if self._folder else file)
            else:
                _check_claims(where, self._infos[name], most)
                opened = self._archive.open(self._infos[name])
            with opened as file:
                part = file.read(size)
                decoder = codecs.getincrementaldecoder("utf-16")() if part.startswith(_UTF_16) else None
                while part:
                    self._n_read += len(part)
                    if self._n_read > self._most:
                        raise RecordingError(
                            f"{where}: unpacks to more than {self._most} bytes; unpack it yourself, if you trust it"
                            if self._open is gzip.open
                            else f"{where}: with this file, more than {self._most} bytes are read; cut the recording"
                        )
                    yield part if decoder is None else decoder.decode(part).encode()
                    part = file.read(size)
        except RecordingError:
            raise
        except OSError as error:
            raise RecordingError(
                f"{where}: cannot be read ({error.strerror or error}); check its permissions, or copy it again"
            ) from error
        except _ZIP_ERRORS as error:
            raise RecordingError(f"{where}: damaged ({error}); copy or export the recording again") from error


@contextmanager
def open_members(path: Path) -> Generator[Members]:
    """Context manager that opens a zip file, a folder or one file, and yields its files as `Members`.

    The path may continue inside a file: `export.zip/walk_2` is the folder walk_2 of the zip. An empty folder has no
    members. RecordingError if the path does not exist, is a file of 0 bytes, or cannot be opened.
    """
    try:
        path, inside = outside(path)
        if not path.exists():
            raise RecordingError(f"{path}: no such file or folder; check the path")
        if path.is_dir():
            yield Members(path, inside=inside)
            return
        with open_regular(path) as file:
            head, is_gzip = file.read(_BEGIN_BYTES), False
            _refuse_others(path, "the file", head)
            if head.startswith(_GZIP):
                packed = Members(path, is_gzip=True)
                head, is_gzip = packed.head(packed.names[0], _BEGIN_BYTES), True
                _refuse_others(path, "the file in it", head)
                if head.startswith(_ZIP):
                    file = io.BytesIO(packed.whole(packed.names[0], limits.MAX_UNPACKED_BYTES))
            if not head.startswith(_ZIP):
                yield Members(path, inside=inside, is_gzip=is_gzip)
                return
            with _in_zip(file, path, inside) as members:
                yield members
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot be read ({error.strerror or error}); check path and permissions"
        ) from error


@contextmanager
def _in_zip(file: IO[bytes], path: Path, inside: str, is_inner: bool = False) -> Generator[Members]:
    """Open the files in a zip file.

    If it only contains another zip file, or `inside` names one in it, the files in that one are opened.
    """
    try:
        archive = zipfile.ZipFile(file)
    except _ZIP_ERRORS as error:
        raise RecordingError(f"{path}: a zip file that is damaged or cut off; copy or export it again") from error
    with archive:
        members = Members(path, archive)
        zips = zips_among(members.names)
        named = [name for name in zips if inside == name or inside.startswith(f"{name}/")]
        if is_inner or not (named or len(zips) == 1):
            yield Members(path, archive, inside) if inside else members
            return
        content = io.BytesIO(members.whole(*(named or zips), most=limits.MAX_UNPACKED_BYTES))
        if named:
            path, inside = path / named[0], inside.removeprefix(named[0]).lstrip("/")
        with _in_zip(content, path, inside, is_inner=True) as members:
            yield members


def _refuse_others(path: Path, what: str, head: bytes) -> None:
    """Raise RecordingError, which names the kind, for an empty file and a known kind that cannot be a recording."""
    if not head:
        raise RecordingError(f"{path}: {what} is empty (0 bytes); copy or export the recording again")
    kind = next((words for begin, words in _OTHERS.items() if head.lower().lstrip().startswith(begin.lower())), "")
    if head[_TAR_AT:].startswith(_TAR):
        kind = "a tar archive; unpack it and give the folder"
    if kind:
        raise RecordingError(f"{path}: {kind}")


def zips_among(names: Sequence[str]) -> list[str]:
    """Return the zip files and .xlsx spreadsheets among names, or none if another file may hold samples."""
    others = [name for name in names if not name.lower().endswith((".zip", ".xlsx"))]
    return [] if any(_ABOUT.search(name) is None for name in others) else [n for n in names if n not in others]


def outside(path: Path) -> tuple[Path, str]:
    """Split a path into a file or folder that exists on disk, and the rest of the path inside it.

    `export.zip/walk_2` has the rest `walk_2`. A trial `walk1` stands for files such as `walk1_acc.csv` in its folder.
    """
    if not path.exists():
        for parent in path.parents:
            if parent.is_file():
                return parent, path.relative_to(parent).as_posix()
        if (
            path.name
            and path.parent.is_dir()
            and any(trial_of(name) == path.name for name in _files_below(path.parent))
        ):
            return path.parent, path.name
    return path, ""


def json_object(content: bytes, where: str) -> dict[str, Any]:
    """Return the object in the content of a small JSON file. RecordingError if it is not JSON or not an object."""
    try:
        value: Any = json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{where}: not JSON ({error}); correct it or leave the file out") from error
    if not isinstance(value, dict):
        raise RecordingError(f"{where}: holds {str(value)[:40]!r}; it must be one object in braces, like {{}}")
    return cast("dict[str, Any]", value)


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a small TOML file. RecordingError if it cannot be read or is not TOML."""
    content = read_small(path, limits.MAX_TOML_BYTES)
    try:
        return tomllib.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{path}: not TOML ({error}); correct it or take it away") from error


def _files_below(path: Path) -> dict[str, Path]:
    """Return the files in a folder by path, with those in `meta` and in folders of sensors, but no deeper ones."""
    found: dict[str, Path] = {}
    below = [entry for entry in path.iterdir() if entry.is_dir() and not entry.is_symlink() and entry.name != "meta"]
    of_sensors = sensor_folders(entry.name for entry in below)
    for folder in (path, path / "meta", *(entry for entry in below if entry.name in of_sensors)):
        if folder.is_dir():
            for entry in folder.iterdir():
                if not entry.is_dir():  # a pipe or a device is refused when it is read, with its name
                    found[entry.relative_to(path).as_posix()] = entry
                if len(found) > limits.MAX_MEMBERS:
                    raise RecordingError(
                        f"{path}: more than {limits.MAX_MEMBERS} files; give the folder of one recording"
                    )
    return found


def _without_sensor_folders(names: Sequence[str]) -> dict[str, str]:
    """Return new names for files of sensors that each have a folder of their own, by their old names.

    `Accelerometer/data.csv` becomes `Accelerometer.csv` if it is the only table in its folder, else
    `data_Accelerometer.csv`.
    """
    by_folder: dict[PurePosixPath, list[PurePosixPath]] = {}
    for name in map(PurePosixPath, names):
        if name.suffix.lower() in _TABLES and name.parent.name not in ("", "meta"):
            by_folder.setdefault(name.parent, []).append(name)
    found: dict[str, str] = {}
    for parent in {folder.parent for folder in by_folder}:
        of_sensors = sensor_folders(folder.name for folder in by_folder if folder.parent == parent)
        flat = {
            str(file): str(parent / f"{f'{file.stem}_' if len(files) > 1 else ''}{folder.name}{file.suffix}")
            for folder, files in by_folder.items()
            if folder.parent == parent and folder.name in of_sensors
            for file in files
        }
        found |= {name: to for name, to in flat.items() if to not in names}
    return found


def _path_of_trial(name: str) -> str:
    """Return the path of the trial of a file: `export/walk1` for `export/walk1_acc.csv`."""
    return str(PurePosixPath(name).parent / trial_of(name))


def sensor_folders(names: Iterable[str]) -> set[str]:
    """Return those names of folders that are of one recording with a folder for each sensor.

    These are names of an accelerometer, of other sensors and of metadata, with equal other words, such as `left_acc`
    and `left_gyro`. Numbers may differ if the sensors are numbered, as in `1_acc` and `2_gyro`.
    """
    by_trial: dict[tuple[str, ...], dict[str, str]] = {}
    for name in names:
        words = trial_of(name).lower().split("_")
        quantity, _ = quantity_of_file(name)
        if quantity or not _BESIDE.isdisjoint(words):
            trial = tuple(word for word in words if word and word not in _BESIDE and word not in _OF_KINDS)
            by_trial.setdefault(trial, {})[name] = quantity
    found = [sensors for sensors in by_trial.values() if _has_force_and_more(sensors)]
    if not found:
        numbered = [sensors for trial, sensors in by_trial.items() if all(map(str.isdecimal, trial))]
        together = {name: quantity for sensors in numbered for name, quantity in sensors.items()}
        found = [together] if _has_force_and_more(together) else []
    return {name for sensors in found for name in sensors}


def _has_force_and_more(sensors: Mapping[str, str]) -> bool:
    kinds = set(sensors.values()) - {""}
    return len(kinds) > 1 and not kinds.isdisjoint((ACCELERATION, LINEAR))


def most_unpacked(size: int) -> int:
    """Return the largest number of bytes that a packed file of this size may unpack to."""
    return max(limits.UNPACKED_FREELY_BYTES, limits.MAX_COMPRESSION_RATIO * size)


def _infos_by_name(path: Path, archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """Return the files in a zip file by their path inside it, with slashes whatever system packed it.

    RecordingError for paths that lead out of it, too many files, two of one path, or if it claims to unpack to too
    much.
    """
    if len(archive.infolist()) > limits.MAX_MEMBERS:
        raise RecordingError(f"{path}: more than {limits.MAX_MEMBERS} files in the zip; pack one recording alone")
    claimed = sum(info.file_size for info in archive.infolist())
    size = archive.fp.seek(0, io.SEEK_END) if archive.fp else 0  # the zip may be inside another one
    if claimed > most_unpacked(size):
        raise RecordingError(
            f"{path} claims to unpack to {claimed} bytes, {claimed / size:.0f} times its size: no sensor data is like "
            "that; unpack it yourself and give the folder, if you trust it"
        )
    found: dict[str, zipfile.ZipInfo] = {}
    for info in archive.infolist():
        name = PurePosixPath(info.filename.replace("\\", "/"))  # some Windows tools write backslashes
        if name.is_absolute() or ".." in name.parts or (name.parts[:1] and name.parts[0].endswith(":")):
            raise RecordingError(f"{path}: member {info.filename!r} points outside the zip; pack it again without it")
        if not info.filename or info.is_dir() or "__MACOSX" in name.parts:
            continue
        if str(name) in found:
            raise RecordingError(f"{path}: {name} is in the zip twice; pack it again with one of them")
        found[str(name)] = info
    return found


def _check_claims(where: str, info: zipfile.ZipInfo, most: int) -> None:
    if info.flag_bits & 0x1:
        raise RecordingError(f"{where} is encrypted; unpack it with its password and pack it again without one")
    if info.compress_type not in SUPPORTED_COMPRESSION:
        raise RecordingError(f"{where} uses zip compression method {info.compress_type}; pack it again with deflate")
    _check_size(where, info.file_size, most)


def _check_size(where: str, n_bytes: int, most: int) -> None:
    if n_bytes > most:
        raise RecordingError(f"{where}: {n_bytes} bytes, more than {most}; cut the recording")
