"""Files of one recording, from a zip file or a folder, read within bounds whatever the file claims."""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from pdr_filter.io.errors import RecordingError

# A day of 400 Hz samples in three sensors is 1.3 GB of text each. More than this is a mistake or an attack.
MAX_MEMBER_BYTES = 2 * 1024**3
# Sensor text compresses 2 to 5 times, and constant columns at most 100 times; deflate can reach 1000 with zeros.
MAX_COMPRESSION_RATIO = 200
RATIO_CHECKED_ABOVE_BYTES = 64 * 1024**2
# zipfile bounds what it unpacks at once for these two only; a few kilobytes of bzip2 or lzma can become gigabytes.
SUPPORTED_COMPRESSION = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# What zipfile raises, beside BadZipFile, for a file whose bytes were changed.
_ZIP_ERRORS = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    NotImplementedError,
    RuntimeError,
    OSError,
    OverflowError,
    LookupError,
    ValueError,
)


def read_members(path: Path, wanted: Iterable[str], required: str) -> dict[str, bytes]:
    """Contents of the wanted files that exist beside the required one, by file name.

    Parameters
    ----------
    path : Path
        A zip file, whose files may sit in a folder inside it, or a folder.
    wanted : iterable of str
        File names, without folder; others are left alone.
    required : str
        The file that makes it a recording; RecordingError if there is none.
    """
    try:
        if path.is_dir():
            return _read_folder(path, wanted, required)
        if not path.exists():
            raise RecordingError(f"{path}: no such file or folder; check the path")
        if not path.is_file():
            raise RecordingError(f"{path}: neither a file nor a folder; give a zip file or a folder")
        if path.stat().st_size == 0:
            raise RecordingError(f"{path}: the file is empty (0 bytes); copy or export the recording again")
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror}); check its permissions") from error
    return _read_zip(path, wanted, required)


def _read_folder(path: Path, wanted: Iterable[str], required: str) -> dict[str, bytes]:
    found = sorted(entry.name for entry in path.iterdir())
    if required not in found:
        raise RecordingError(_not_a_recording(path, required, found))
    contents: dict[str, bytes] = {}
    for name in wanted:
        if name in found:
            size = (path / name).stat().st_size
            if size > MAX_MEMBER_BYTES:
                raise RecordingError(f"{path / name}: {size} bytes, more than {MAX_MEMBER_BYTES}; cut the recording")
            contents[name] = (path / name).read_bytes()
    return contents


def _read_zip(path: Path, wanted: Iterable[str], required: str) -> dict[str, bytes]:
    try:
        with zipfile.ZipFile(path) as archive:
            members = _members_by_name(path, archive)
            folder = _folder_of(path, members, required)
            return {
                name: _read_member(path, archive, members[folder / name]) for name in wanted if folder / name in members
            }
    except RecordingError:
        raise
    except _ZIP_ERRORS as error:
        raise RecordingError(
            f"{path}: not a zip file, or a damaged one ({error}); give an intact zip file, "
            f"or the folder that holds {required}"
        ) from error


def _members_by_name(path: Path, archive: zipfile.ZipFile) -> dict[PurePosixPath, zipfile.ZipInfo]:
    members: dict[PurePosixPath, zipfile.ZipInfo] = {}
    for info in archive.infolist():
        name = PurePosixPath(info.filename.replace("\\", "/"))  # some Windows tools write backslashes
        if name.is_absolute() or ".." in name.parts or (name.parts[:1] and name.parts[0].endswith(":")):
            raise RecordingError(f"{path}: member {info.filename!r} points outside the zip; pack it again without it")
        if info.is_dir() or "__MACOSX" in name.parts:
            continue
        if name in members:
            raise RecordingError(f"{path}: {name} is in the zip twice; pack it again with one of them")
        members[name] = info
    return members


def _folder_of(path: Path, members: Iterable[PurePosixPath], required: str) -> PurePosixPath:
    names = list(members)
    folders = [name.parent for name in names if name.name == required]
    if not folders:
        raise RecordingError(_not_a_recording(path, required, sorted(map(str, names))))
    if len(folders) > 1:
        raise RecordingError(
            f"{path}: holds {len(folders)} recordings ({', '.join(map(str, folders[:3]))}); make one zip of each"
        )
    return folders[0]


def _read_member(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    where = f"{path}: {info.filename}"
    if info.flag_bits & 0x1:
        raise RecordingError(f"{where} is encrypted; unpack it with its password and pack it again without one")
    if info.compress_type not in SUPPORTED_COMPRESSION:
        raise RecordingError(f"{where} uses zip compression method {info.compress_type}; pack it again with deflate")
    ratio = info.file_size / max(info.compress_size, 1)
    if info.file_size > MAX_MEMBER_BYTES:
        raise RecordingError(f"{where} claims {info.file_size} bytes, more than {MAX_MEMBER_BYTES}; cut the recording")
    if info.file_size > RATIO_CHECKED_ABOVE_BYTES and ratio > MAX_COMPRESSION_RATIO:
        raise RecordingError(
            f"{where} claims to unpack to {info.file_size} bytes, {ratio:.0f} times its size: no sensor data is like "
            "that; unpack it yourself and give the folder, if you trust it"
        )
    with archive.open(info) as member:
        content = member.read(info.file_size + 1)  # zipfile unpacks at most this much, and then checks the CRC
    if len(content) != info.file_size:
        raise RecordingError(f"{where} is cut off or longer than the zip says; copy the zip again")
    return content


def _not_a_recording(path: Path, required: str, found: list[str]) -> str:
    listed = ", ".join(found[:8]) + (f" and {len(found) - 8} more" if len(found) > 8 else "")
    return f"{path}: no recording, because it has no {required} (found: {listed or 'nothing'}); add that file"
