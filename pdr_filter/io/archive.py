"""Files of one recording, from a zip file or a folder, read within bounds whatever the file claims."""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from pdr_filter.io.errors import RecordingError

# A day of 400 Hz samples in three sensors is 1.3 GB of text each. More than this is a mistake or an attack.
MAX_MEMBER_BYTES = 2 * 1024**3
# Sensor text compresses 2 to 5 times, and constant columns at most 100 times; deflate can reach 1000 with zeros.
MAX_COMPRESSION_RATIO = 200
RATIO_CHECKED_ABOVE_BYTES = 64 * 1024**2
# zipfile bounds what it unpacks at once for these two only; a few kilobytes of bzip2 or lzma can become gigabytes.
SUPPORTED_COMPRESSION = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# Files are parsed in blocks of this size, so that the text of a recording never is in memory as a whole.
BLOCK_BYTES = 4 * 1024**2
# Rows of sensor data have some hundred bytes, and one line of a header some thousand.
MAX_LINE_BYTES = 1024**2
# A recording has tens of files; listing a million members of a hostile zip is refused.
MAX_MEMBERS = 10_000
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


class Members:
    """The files of a recording: those of a zip or a folder, or one file alone. Nothing is unpacked to disk.

    Attributes
    ----------
    path : Path
        What was opened.
    names : tuple of str
        Paths inside it, with forward slashes, sorted.
    """

    def __init__(self, path: Path, archive: zipfile.ZipFile | None) -> None:
        self.path = path
        self._archive = archive
        self._infos: dict[str, zipfile.ZipInfo] = {}
        self._files: dict[str, Path] = {}
        if archive is not None:
            if len(archive.infolist()) > MAX_MEMBERS:
                raise RecordingError(f"{path}: more than {MAX_MEMBERS} files in the zip; pack one recording alone")
            self._infos = {str(name): info for name, info in _members_by_name(path, archive).items()}
        elif path.is_dir():
            self._files = _files_below(path)
        else:
            self._files = {path.name: path}
        self.names = tuple(sorted(self._infos or self._files))

    def where(self, name: str) -> str:
        """How messages call a member."""
        return f"{self.path}" if self.path.name == name else f"{self.path}: {name}"

    def size(self, name: str) -> int:
        """Bytes of a member after unpacking, as the zip says."""
        return self._infos[name].file_size if self._archive is not None else self._files[name].stat().st_size

    def content(self, name: str, most: int = MAX_LINE_BYTES) -> bytes:
        """The first `most` bytes of a member."""
        parts: list[bytes] = []
        for part in self._parts(name, min(most, BLOCK_BYTES)):
            parts.append(part)
            most -= len(part)
            if most <= 0:
                break
        return b"".join(parts)

    def pieces(self, name: str) -> Iterator[bytes]:
        """The bytes of a member in pieces that end anywhere; without byte order mark, UTF-16 is refused."""
        for i, part in enumerate(self._parts(name, BLOCK_BYTES)):
            if i == 0:
                refuse_two_byte_text(part, self.where(name))
            yield part.removeprefix(b"\xef\xbb\xbf") if i == 0 else part

    def blocks(self, name: str) -> Iterator[bytes]:
        """The text of a member in blocks that end with a line; the last one may not, where the file does not.

        Line ends become a line feed and a byte order mark is dropped. UTF-16 and other texts with zero bytes are
        refused, and so are lines without end.
        """
        rest = b""
        for part in self.pieces(name):
            block = rest + part
            if b"\n" not in block and b"\r" in block[:-1]:  # line ends of old Macintosh programs
                block = block.replace(b"\r", b"\n")
            cut = block.rfind(b"\n") + 1
            block, rest = block[:cut], block[cut:]
            if len(rest) > MAX_LINE_BYTES:
                raise RecordingError(
                    f"{self.where(name)}: a line of more than {MAX_LINE_BYTES} bytes; this is no table"
                )
            if block:
                yield block.replace(b"\r\n", b"\n") if b"\r" in block else block
        if rest:
            yield rest.replace(b"\r", b"\n")

    def _parts(self, name: str, size: int) -> Iterator[bytes]:
        try:
            if self._archive is None:
                if self.size(name) > MAX_MEMBER_BYTES:
                    raise RecordingError(
                        f"{self.where(name)}: {self.size(name)} bytes, more than {MAX_MEMBER_BYTES}; cut the recording"
                    )
                with self._files[name].open("rb") as file:
                    while part := file.read(size):
                        yield part
                return
            info = self._infos[name]
            _check_member(self.where(name), info)
            with self._archive.open(info) as member:
                while part := member.read(size):  # unpacks no more than this at once; checks the CRC at the end
                    yield part
        except RecordingError:
            raise
        except OSError as error:
            raise RecordingError(f"{self.where(name)}: cannot be read ({error.strerror or error})") from error
        except _ZIP_ERRORS as error:
            raise RecordingError(
                f"{self.where(name)}: damaged ({error}); copy or export the recording again"
            ) from error


@contextmanager
def open_members(path: Path) -> Generator[Members]:
    """Open a zip, a folder or one file; RecordingError if it is not there, is empty or cannot be opened."""
    try:
        if not path.exists():
            raise RecordingError(f"{path}: no such file or folder; check the path")
        if not path.is_dir() and not path.is_file():
            raise RecordingError(f"{path}: neither a file nor a folder; give a zip file or a folder")
        if path.is_file() and path.stat().st_size == 0:
            raise RecordingError(f"{path}: the file is empty (0 bytes); copy or export the recording again")
        if path.is_file() and _begins_like_zip(path):
            try:
                archive = zipfile.ZipFile(path)
            except _ZIP_ERRORS as error:
                raise RecordingError(f"{path}: not a zip file, or a damaged one ({error}); copy it again") from error
            with archive:
                try:
                    members = Members(path, archive)
                except RecordingError:
                    raise
                except _ZIP_ERRORS as error:
                    raise RecordingError(f"{path}: a damaged zip file ({error}); copy it again") from error
                yield members
        else:
            yield Members(path, None)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror}); check its permissions") from error


def refuse_two_byte_text(head: bytes, where: str) -> None:
    """Refuse UTF-16 and UTF-32, with or without byte order mark, and binary files: all have zero bytes."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\x00" in head[:4096]:
        raise RecordingError(f"{where}: not UTF-8 text but UTF-16 or a binary file; save it as UTF-8")


def _begins_like_zip(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(2) == b"PK"


def _files_below(path: Path) -> dict[str, Path]:
    """Files in a folder and in its folder `meta`, by path inside it; not deeper: it may be anybody's home folder."""
    found: dict[str, Path] = {}
    for folder in (path, path / "meta"):
        if folder.is_dir():
            for entry in folder.iterdir():
                if entry.is_file():
                    found[entry.relative_to(path).as_posix()] = entry
                if len(found) > MAX_MEMBERS:
                    raise RecordingError(f"{path}: more than {MAX_MEMBERS} files; give the folder of one recording")
    return found


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


def _check_member(where: str, info: zipfile.ZipInfo) -> None:
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


def _read_member(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    where = f"{path}: {info.filename}"
    _check_member(where, info)
    with archive.open(info) as member:
        content = member.read(info.file_size + 1)  # zipfile unpacks at most this much, and then checks the CRC
    if len(content) != info.file_size:
        raise RecordingError(f"{where} is cut off or longer than the zip says; copy the zip again")
    return content


def _not_a_recording(path: Path, required: str, found: list[str]) -> str:
    listed = ", ".join(found[:8]) + (f" and {len(found) - 8} more" if len(found) > 8 else "")
    return f"{path}: no recording, because it has no {required} (found: {listed or 'nothing'}); add that file"
