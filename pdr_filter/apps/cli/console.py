"""Output of the commands (tables on stdout, progress and errors on stderr), and their exit codes."""

from __future__ import annotations

import errno
import json
import re
import textwrap
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from glob import escape as glob_escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import typer
from rich import markup
from rich.cells import cell_len
from rich.console import Console
from rich.table import Column, Table

from pdr_filter.values.optional_packages import is_available
from pdr_filter.values.sanitise import file_name, free_name, printable, printable_lines

if TYPE_CHECKING:
    from pdr_filter.tracking.track import Track
    from pdr_filter.values.recording import Recording

# Maximum width of a word in a table, in characters. Longer words are split, so that one long file name does not squeeze
# the other columns.
_WIDEST_WORD = 40
_NUMBER = re.compile(r"[-+]?\d[\d.]*")
_COLUMN_GAP = 3  # characters between the columns of a table
SOME_FAILED, UNUSABLE, STOPPED = 1, 2, 130
_NOT_SMOOTHED = (
    "this is the online track and not the smoothed one: gtsam is not installed; pip install gtsam (it has no wheel for "
    "Windows), or use --online to omit this warning"
)

T = TypeVar("T")


def stderr() -> Console:
    """Return a console for messages. It is created at each call, so that a redirected stderr is respected."""
    return Console(stderr=True, highlight=False, soft_wrap=True)


def escape(text: object) -> str:
    """Return untrusted text, such as a file name, without markup and control characters that affect the terminal."""
    return markup.escape(printable_lines(text))


def message(error: Exception) -> str:
    """Return the message of an error, or the name of its class if the message is empty.

    An OSError of a file gives the path and the usual remedy. Line breaks stay, because some messages have lines to
    copy.
    """
    if isinstance(error, OSError) and error.strerror and error.filename:
        remedy = {
            errno.EEXIST: "a file with this name exists where a folder is needed; give another name",
            errno.ENOTDIR: "a part of this path is a file, not a folder; give another name",
            errno.EISDIR: "a folder with this name exists where a file is needed; give another name",
            errno.ENOSPC: "the disk is full; free some space",
            errno.ENOENT: "no such file or folder; check the path",
            errno.EACCES: "permission denied; check the permissions of this path",
        }.get(error.errno or 0, error.strerror)
        return f"{error.filename}: {remedy}"
    lines = [line.rstrip() for line in str(error).splitlines() if line.strip()]
    return "\n".join(lines) or type(error).__name__


def say(text: object) -> None:
    """Print a message on stderr, without markup and control characters of names in it."""
    stderr().print(escape(text))


def say_error(text: str) -> None:
    """Print an error message on stderr."""
    stderr().print(f"[bold red]error:[/] {escape(text)}")


def existing(*paths: Path | None) -> list[Path]:
    """Return the paths that exist. Call it before writing, to know which files are replaced."""
    return [path for path in paths if path is not None and path.exists()]


def say_replaced(paths: Sequence[Path]) -> None:
    """Print the files that existed before and were replaced."""
    if paths:
        say(f"replaced existing files: {', '.join(map(str, paths))}")


def say_unused_fixes(unused: Mapping[Path, Path], or_from: str = "") -> None:
    """Print files `fixes.csv` that lie beside recordings and are not used, with the place where they are read.

    `unused` maps each file to the marks of a recording beside it, and `or_from` names another place.
    """
    for path, marks in unused.items():
        recording = marks.parent.name.removesuffix(".marks")
        say(f"{path} is not used: known positions of {recording} are read from {marks}{or_from}")


def say_without_truth(names: Sequence[str]) -> None:
    """Print the recordings for which no error can be computed."""
    if names:
        say(f"no position error, because the file has no true positions or waypoints: {', '.join(names)}")


def say_written(folder: Path | None) -> None:
    """Print the folder to which files were written, unless it is None."""
    if folder is not None:
        say(f"files written to {folder}")


@contextmanager
def one_line_errors() -> Generator[None]:
    """Turn ValueError, OSError and the ImportError of an optional package into a one-line message and exit code 2."""
    try:
        yield
    except (ValueError, OSError, ImportError) as error:
        say_error(message(error))
        raise typer.Exit(UNUSABLE) from None


@contextmanager
def progress(what: str) -> Generator[Callable[..., None]]:
    """Show a progress bar on stderr if it is a terminal; yield a function of the fraction done and a description."""
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    times = TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn()
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), *times)
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(escape(what), total=1.0)

        def show(fraction: float, description: str | None = None) -> None:
            bar.update(task, completed=fraction, description=escape(description or what))

        yield show


def recording_paths(paths: Sequence[Path]) -> list[Path]:
    """Return the paths of all recordings.

    A folder, or a file with several recordings, is replaced by its recordings. A path that does not exist is kept.
    ValueError for a folder without recordings.
    """
    from pdr_filter.data.io.folders import recordings_in

    found: list[Path] = []
    for path in paths:
        inside = recordings_in(path) if path.exists() else [path]
        if not inside:
            raise ValueError(
                f"{path}: no recordings in this folder or its subfolders; pdr-filter info "
                "FILE says why a file is not a recording"
            )
        found += inside
    return found


def each_file(
    files: Sequence[Path], work: Callable[[Path, Callable[[float], None]], T], as_json: bool = False
) -> tuple[list[T], dict[Path, str]]:
    """Apply `work` to each file and return the results, and the error message of each file that failed.

    `work` takes the file and a function that it calls with the fraction done. Error messages are printed on stderr, and
    as JSON objects on stdout if `as_json` is true. Ctrl+C ends the command and prints the files that remain.
    """
    results: list[T] = []
    failed: dict[Path, str] = {}
    with progress("reading") as show:
        for i, file in enumerate(files):

            def show_part(fraction: float, i: int = i, file: Path = file) -> None:
                show((i + fraction) / len(files), file.name)

            show_part(0.0)
            try:
                results.append(work(file, show_part))
            except KeyboardInterrupt:
                for reason in failed.values():
                    say_error(reason)
                more = f" and {n} more" if (n := len(files) - i - 1) else ""
                say(
                    f"stopped: {len(results)} of {len(files)} done, with complete output files; to continue, run the "
                    f"command on the remaining files: {file}{more}"
                )
                raise typer.Exit(STOPPED) from None
            except (ValueError, OSError) as error:
                failed[file] = message(error)
                if as_json:
                    print_json({"name": file.stem, "error": failed[file]})
    for reason in failed.values():
        say_error(reason)
    return results, failed


def exit_if_failed(failed: Mapping[Path, str], n_files: int) -> None:
    """Exit with code 2 if all files failed, and with code 1 if some failed. Of several files, print which."""
    if not failed:
        return
    if n_files == 1:
        raise typer.Exit(UNUSABLE)
    say(f"{len(failed)} of {n_files} files failed: {', '.join(map(str, failed))}")
    raise typer.Exit(UNUSABLE if len(failed) == n_files else SOME_FAILED)


def print_json(value: Mapping[str, Any]) -> None:
    """Print a JSON object on one line."""
    typer.echo(json.dumps(value, allow_nan=False))


def print_notes(tracks: Sequence[Track]) -> None:
    """Print the notes of tracks, one line each. Notes that differ only in their numbers are printed once."""
    alike: dict[str, dict[int, str]] = {}
    for i, track in enumerate(tracks):
        for note in track.notes:
            alike.setdefault(_NUMBER.sub("0", note), {}).setdefault(i, note)
    for note, *more in (list(notes.values()) for notes in alike.values()):
        first = next(track.name for track in tracks if note in track.notes)
        of_all = f"{len(more) + 1} of {len(tracks)} recordings"
        prefix = first if not more else of_all if set(more) == {note} else f"{of_all}, such as {first}"
        print_line(f"{prefix}: {note}")


def print_line(text: str) -> None:
    """Print a line on stdout. It is wrapped between words on a terminal only, so that scripts can parse the output."""
    stdout = Console(highlight=False)
    stdout.print(markup.escape(printable(text)), soft_wrap=not stdout.is_terminal)


def print_lines(text: str) -> None:
    """Print the lines of a report on stdout."""
    for line in text.split("\n"):
        print_line(line)


def new_table(*columns: str, n_keys: int = 1) -> Table:
    """Return an empty table. The first `n_keys` columns identify the rows; the others are right-aligned numbers."""
    from rich import box

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < n_keys else "right", overflow="fold")
    return table


def print_table(table: Table) -> None:
    """Print a table. A table that is wider than the terminal is split into several parts, so that no word is broken.

    Each part begins with the columns that identify the rows. If stdout is not a terminal, the table may be 160
    characters wide.
    """
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=max(console.width, 160))
    n_keys = next((i for i, column in enumerate(table.columns) if column.justify != "left"), len(table.columns))
    keys = table.columns[:n_keys]
    parts = [list(keys)]
    for column in table.columns[n_keys:]:
        if len(parts[-1]) > n_keys and sum(map(_least_width, [*parts[-1], column])) > console.width:
            parts.append(list(keys))
        parts[-1].append(column)
    for columns in parts:
        console.print(_part(table, columns, console.width))
    if table.caption:
        console.print(f" {table.caption}", style="dim italic")


def _least_width(column: Column) -> int:
    """Return the smallest width that breaks no number, name or list item, including the gap to the next column."""
    cells = [str(cell) for cell in column.cells]
    whole = cells if column.justify == "right" else [part for cell in cells for part in re.split(r"(?<=,) ", cell)]
    return min(max(map(cell_len, [*str(column.header).split(), *whole]), default=0), _WIDEST_WORD) + _COLUMN_GAP


def _part(table: Table, columns: Sequence[Column], width: int) -> Table:
    """Return a table of some columns. Left-aligned columns share the remaining width."""
    widths = [_least_width(column) - _COLUMN_GAP for column in columns]
    left = width - sum(widths) - _COLUMN_GAP * len(widths)
    part = Table(box=table.box, pad_edge=False)
    for column, least in zip(columns, widths, strict=True):
        wanted = max(map(cell_len, [str(column.header), *map(str, column.cells)]))
        more = min(max(wanted - least, 0), max(left, 0)) if column.justify == "left" else 0
        left -= more
        part.add_column(column.header, justify=column.justify, overflow="fold", width=least + more)
    for cells, row in zip(zip(*(column.cells for column in columns), strict=True), table.rows, strict=True):
        in_parts = [_broken_at_commas(str(c), part.columns[i].width or width) for i, c in enumerate(cells)]
        part.add_row(*in_parts, end_section=row.end_section)
    return part


def _broken_at_commas(cell: str, width: int) -> str:
    """Wrap a list such as "walking 3 s, upstairs 1 s" to a width, with line breaks only after commas."""
    return textwrap.fill(re.sub(r"(?<!,) ", "\0", cell), max(width, 1), break_on_hyphens=False).replace("\0", " ")


# Caption of tables with a column "± at the end".
STD_CAPTION = "±: one standard deviation in the worst direction"
_SMOOTHED = "smoothed from the whole recording; --online shows the estimates available at each step"


def in_m(value: float, spec: str = "z.1f") -> str:
    """Return a length in metres as text with its unit, such as "1.2 m". `spec` is the format of the number."""
    return f"{value:{spec}} m"


def end_of(track: Track) -> tuple[str, str]:
    """Return how far east and north a track ends as texts, or "unknown" (`trust_report.is_end_known`)."""
    from pdr_filter.tracking.trust_report import is_end_known

    if not is_end_known(track):
        return "unknown", "unknown"
    east_m, north_m = track.end_position_m.tolist()
    return in_m(east_m), in_m(north_m)


def end_caption(tracks: Sequence[Track]) -> str:
    """Return the caption that names the zero of the columns "end east" and "end north" of a table of tracks."""
    zeros = list(dict.fromkeys(map(_zero_of, tracks)))
    return f"end: metres from {zeros[0] if len(zeros) == 1 else 'the zero of each track, which its report names'}"


def _zero_of(track: Track) -> str:
    """Return where a track has its zero, as text."""
    if not track.start_position_m.any():
        return "the start"
    if track.origin is not None:
        return f"{track.origin.latitude_deg:.6f}, {track.origin.longitude_deg:.6f}"
    return "the zero of the floor plan" if track.frame == "plan" else "the zero of the fixes"


def print_tracks(tracks: Sequence[Track], by_phone: Sequence[int | None] = ()) -> None:
    """Print a table with a row for each track, and the notes of the tracks below.

    `by_phone` are the steps that the phones counted themselves, None where a file does not have them. They are a column
    if one has them.
    """
    is_counted = any(count is not None for count in by_phone)
    from pdr_filter.tracking.trust_report import context_durations

    steps = ("steps", "steps by the phone") if is_counted else ("steps",)
    table = new_table("recording", *steps, "distance", "end east", "end north", "± at the end", "duration")
    table.add_column("contexts")
    for i, result in enumerate(tracks):
        counted = [_or_blank(by_phone[i])] if is_counted else []
        table.add_row(
            escape(result.name),
            str(result.n_steps),
            *counted,
            result.how_far,
            *end_of(result),
            in_m(result.position_std_m[-1]) if result.n_steps else "",
            f"{result.duration_s:.1f} s",
            escape(context_durations(result)),
        )
    captions = [end_caption(tracks), STD_CAPTION, *([_SMOOTHED] if any(t.is_smoothed for t in tracks) else [])]
    table.caption = "\n ".join(captions)
    print_table(table)
    print_notes(tracks)


def _or_blank(count: int | None) -> str:
    return "" if count is None else str(count)


def estimates(
    recording: Recording,
    online: bool,
    loop: bool,
    with_both: bool,
    progress: Callable[[float], None] | None,
    **options: Any,
) -> tuple[Track, ...]:
    """Return the smoothed track, followed by the online track if `with_both`, or the online track alone if `online`.

    Without gtsam, the result is the online track, with a note. With `loop` it is an ImportError.
    `options` are passed to `pdr_filter.track` and `pdr_filter.smooth`. ValueError for `online` with `loop`.
    """
    import pdr_filter as pdr

    if online and loop:
        raise ValueError(
            "--loop cannot be used with --online, because the loop is known only "
            "when the walk has ended: omit one of them"
        )
    if online:
        return (pdr.track(recording, progress=progress, **options),)
    if not loop and not is_available("gtsam"):
        track = pdr.track(recording, progress=progress, **options)
        return (replace(track, notes=(*track.notes, _NOT_SMOOTHED)),)
    smoothed = pdr.smooth(recording, loop=loop, progress=progress, **options).track
    return (smoothed, pdr.track(recording, **options)) if with_both else (smoothed,)


def write_track(result: Track, folder: Path, name: str) -> None:
    """Write the table NAME.csv and the picture NAME.png of a track, and the map NAME.geojson if it is on Earth."""
    result.to_csv(folder / f"{name}.csv")
    result.plot(folder / f"{name}.png")
    if result.origin is not None:
        result.to_geojson(folder / f"{name}.geojson")


def modified_ns(folder: Path, name: str | None = None) -> dict[Path, int]:
    """Return the existing files NAME.* in a folder, or all its files, with their modification times in nanoseconds."""
    pattern = "*" if name is None else f"{glob_escape(name)}.*"
    return {path: path.stat().st_mtime_ns for path in folder.glob(pattern) if path.is_file()}


def overwritten(before: Mapping[Path, int]) -> list[Path]:
    """Return the files whose modification time has changed since `before`."""
    return [path for path in sorted(before) if path.exists() and path.stat().st_mtime_ns != before[path]]


def unique_name(name: str, written: set[str]) -> str:
    """Return a file name for the name of a recording that is not in `written`, and add it to `written`."""
    free = free_name(file_name(name), written.__contains__)
    written.add(free)
    return free
