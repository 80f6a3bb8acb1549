"""What the commands print where: tables on stdout, progress, notes and errors on stderr; and how they end."""

from __future__ import annotations

import errno
import json
import re
import textwrap
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from glob import escape as glob_escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import typer
from rich import markup
from rich.cells import cell_len
from rich.console import Console
from rich.table import Column, Table

from pdr_filter.values.sanitise import printable, printable_lines

if TYPE_CHECKING:
    from pdr_filter.tracking.track import Track
    from pdr_filter.values.recording import Recording

# Characters. Longer words of a table are split, so that one long file name does not squeeze the other columns.
_WIDEST_WORD = 40
_NUMBER = re.compile(r"[-+]?\d[\d.]*")
_BETWEEN = 3  # cells between the columns of a table
SOME_FAILED, UNUSABLE, STOPPED = 1, 2, 130

T = TypeVar("T")


def stderr() -> Console:
    """Console of the messages; made when used, so that a redirected stderr is respected."""
    return Console(stderr=True, highlight=False, soft_wrap=True)


def escape(text: object) -> str:
    """Text of a file or of its name as a console prints it: as text, without effect on the terminal."""
    return markup.escape(printable_lines(text))


def message(error: Exception) -> str:
    """An error's words, or its kind if it has none; lines that are a file to copy stay lines."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        remedy = {
            errno.EEXIST: "a file is there where a folder is to be; give another name",
            errno.ENOTDIR: "a part of this path is a file and not a folder; give another name",
            errno.EISDIR: "a folder is there where a file is to be; give another name",
            errno.ENOSPC: "the disk is full",
            errno.ENOENT: "there is no such file or folder; check the path",
            errno.EACCES: "this is not permitted; check who may write there",
        }.get(error.errno or 0, error.strerror)
        return f"{error.filename}: {remedy}"
    lines = [line.rstrip() for line in str(error).splitlines() if line.strip()]
    return "\n".join(lines) or type(error).__name__


def say_error(words: str) -> None:
    """One line on stderr."""
    stderr().print(f"[bold red]error:[/] {escape(words)}")


def there(*paths: Path | None) -> list[Path]:
    """Those of the paths that are there before something is written to them."""
    return [path for path in paths if path is not None and path.exists()]


def say_replaced(paths: Sequence[Path]) -> None:
    """Name the files that were there before."""
    if paths:
        stderr().print(f"replaced, as they were there before: {escape(', '.join(map(str, paths)))}")


def say_without_truth(names: Sequence[str]) -> None:
    """Name the recordings that nothing can be held against."""
    if names:
        words = "no true positions or waypoints in the file, so there is no error of"
        stderr().print(f"{words} {escape(', '.join(names))}")


def say_written(folder: Path | None) -> None:
    """Where files were written, if any were."""
    if folder is not None:
        stderr().print(f"files written to {escape(str(folder))}")


@contextmanager
def one_line_errors() -> Generator[None]:
    """What cannot be used ends the command with one line that says why."""
    try:
        yield
    except (ValueError, OSError) as error:
        say_error(message(error))
        raise typer.Exit(UNUSABLE) from None


@contextmanager
def progress(what: str) -> Generator[Callable[..., None]]:
    """A bar on stderr while it runs, if somebody watches; yields a function of the fraction done (and of what)."""
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(escape(what), total=1.0)

        def show(fraction: float, description: str | None = None) -> None:
            bar.update(task, completed=fraction, description=escape(description or what))

        yield show


def recordings_of(paths: Sequence[Path]) -> list[Path]:
    """The recordings that paths stand for: a folder, or a file that holds several, for each in it."""
    from pdr_filter.io.folders import recordings_in

    found: list[Path] = []
    for path in paths:
        inside = recordings_in(path) if path.exists() else [path]
        if not inside:
            raise ValueError(f"{path}: no recordings in this folder or below; pdr-filter info FILE says why of a file")
        found += inside
    return found


def each(
    files: Sequence[Path], work: Callable[[Path, Callable[[float], None]], T], as_json: bool = False
) -> tuple[list[T], dict[Path, str]]:
    """Results of the files that can be used, and why the others cannot, which stderr says, or a JSON object."""
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
                left = f"{escape(str(file))}" + (f" and {n} more" if (n := len(files) - i - 1) else "")
                stderr().print(
                    f"stopped: {len(results)} of {len(files)} done, whose files are whole; to go on, give what is "
                    f"left: {left}"
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
    """End with the code of what failed, which is that of unusable input if all did; of one its reason has been said."""
    if not failed:
        return
    if n_files == 1:
        raise typer.Exit(UNUSABLE)
    stderr().print(f"{len(failed)} of {n_files} files failed: {escape(', '.join(map(str, failed)))}")
    raise typer.Exit(UNUSABLE if len(failed) == n_files else SOME_FAILED)


def print_json(value: Mapping[str, Any]) -> None:
    """One object on one line."""
    typer.echo(json.dumps(value, allow_nan=False))


def print_notes(tracks: Sequence[Track]) -> None:
    """Print a line for each note; one that several tracks share, except for its numbers, stands once.

    Such a line has the number of tracks, and the numbers of the first one.
    """
    alike: dict[str, dict[int, str]] = {}
    for i, track in enumerate(tracks):
        for note in track.notes:
            alike.setdefault(_NUMBER.sub("0", note), {}).setdefault(i, note)
    for note, *more in (list(notes.values()) for notes in alike.values()):
        first = next(track.name for track in tracks if note in track.notes)
        of_all = f"{len(more) + 1} of {len(tracks)} recordings"
        whose = first if not more else of_all if set(more) == {note} else f"{of_all}, such as {first}"
        print_line(f"{whose}: {note}")


def print_line(text: str) -> None:
    """Print a line on stdout, broken between words on a terminal and never elsewhere, so that scripts can read it."""
    stdout = Console(highlight=False)
    stdout.print(markup.escape(printable(text)), soft_wrap=not stdout.is_terminal)


def new_table(*columns: str, n_keys: int = 1) -> Table:
    """A table with words in the first columns, which tell rows apart, and right-aligned numbers in the others."""
    from rich import box

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < n_keys else "right", overflow="fold")
    return table


def print_table(table: Table) -> None:
    """Print a table, in several parts if it is wider than the terminal, so that no word is broken.

    Each part begins with the columns that tell rows apart. A pipe has no width: there the table is as wide as it needs.
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
    """Width without a line break within a number, a name or a part of a list, and the space beside it."""
    cells = [str(cell) for cell in column.cells]
    whole = cells if column.justify == "right" else [part for cell in cells for part in re.split(r"(?<=,) ", cell)]
    return min(max(map(cell_len, [*str(column.header).split(), *whole]), default=0), _WIDEST_WORD) + _BETWEEN


def _part(table: Table, columns: Sequence[Column], width: int) -> Table:
    """Some columns of a table; those of words are as wide as is left for them."""
    widths = [_least_width(column) - _BETWEEN for column in columns]
    left = width - sum(widths) - _BETWEEN * len(widths)
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
    """A list such as "walking 3 s, upstairs 1 s" in lines of this width that end with one of its commas."""
    return textwrap.fill(re.sub(r"(?<!,) ", "\0", cell), max(width, 1), break_on_hyphens=False).replace("\0", " ")


# Below tables with a column "± at the end".
SURE = "±: one standard deviation in the worst direction"
_SMOOTHED = "smoothed from the whole recording; --online shows what a phone knew at each step"


def in_m(value: float, spec: str = "z.1f") -> str:
    """A length."""
    return f"{value:{spec}} m"


def print_tracks(tracks: Sequence[Track]) -> None:
    """A row for each track, their notes below."""
    table = new_table("recording", "steps", "distance", "end east", "end north", "± at the end", "duration")
    table.add_column("contexts")
    for result in tracks:
        summary = result.summary()
        seconds: dict[str, float] = {**summary["contexts"], "moving without steps": summary["moving_without_steps_s"]}
        table.add_row(
            escape(result.name),
            str(result.n_steps),
            in_m(result.distance_m),
            in_m(summary["end_east_m"]),
            in_m(summary["end_north_m"]),
            in_m(summary["end_std_m"]) if result.n_steps else "",
            f"{result.duration_s:.1f} s",
            ", ".join(f"{escape(name)} {value:.0f} s" for name, value in seconds.items() if value >= 0.5),
        )
    table.caption = f"{SURE}\n {_SMOOTHED}" if any(track.is_smoothed for track in tracks) else SURE
    print_table(table)
    print_notes(tracks)


def estimates(
    recording: Recording,
    online: bool,
    loop: bool,
    with_both: bool,
    progress: Callable[[float], None] | None,
    **options: Any,
) -> tuple[Track, ...]:
    """The smoothed track of a recording, and the online one if both are wanted; with `online` that one alone.

    `options` are those of `pdr_filter.track`.
    """
    import pdr_filter as pdr

    if online and loop:
        raise ValueError("--loop is known at the end of a walk, and --online shows what was known before: give one")
    if online:
        return (pdr.track(recording, progress=progress, **options),)
    smoothed = pdr.smooth(recording, loop=loop, progress=progress, **options).track
    return (smoothed, pdr.track(recording, **options)) if with_both else (smoothed,)


def write_map(result: Track, path: Path) -> Path:
    """The map file of a track, .geojson; one that lies nowhere on Earth says so in its name and content."""
    return result.to_local_geojson(path) if result.origin is None else result.to_geojson(path)


def write_track(result: Track, folder: Path, name: str) -> None:
    """The table and the picture of a track."""
    result.to_csv(folder / f"{name}.csv")
    result.plot(folder / f"{name}.png")


def files_of(folder: Path, name: str) -> dict[Path, int]:
    """When each file of a track that is there was written, in ns."""
    return {path: path.stat().st_mtime_ns for path in folder.glob(f"{glob_escape(name)}.*") if path.is_file()}


def replaced_of(before: Mapping[Path, int]) -> list[Path]:
    """Those files that were written anew since."""
    return [path for path in sorted(before) if path.exists() and path.stat().st_mtime_ns != before[path]]


def unused(name: str, written: set[str]) -> str:
    """The name for the files of a track: a second recording of the same name gets a number."""
    found = name
    while found in written:
        found = f"{name}_{len(written) + 1}"
    written.add(found)
    return found
