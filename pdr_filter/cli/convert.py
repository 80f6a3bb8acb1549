"""`pdr-filter convert`: a file of any app as a recording, with what was guessed of its columns and why."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from pdr_filter.cli import console
from pdr_filter.values.sanitise import file_name, printable, printable_lines


class PlatformOption(StrEnum):
    """Whose sign an accelerometer has."""

    IOS = "ios"
    ANDROID = "android"


def convert(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A file or folder of any app.")],
    mapping: Annotated[
        Path | None, typer.Option("--map", help="TOML file that says which column is what; else it is guessed.")
    ] = None,
    platform: Annotated[
        PlatformOption | None, typer.Option(help="Where the file was recorded, if nothing in it shows the sign.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Where the recording goes: NAME_recording.zip beside FILE if not given.")
    ] = None,
) -> None:
    """Convert a file to a recording, and show what its columns were taken for and why.

    The mapping of a table is written beside the recording, as NAME_recording.toml: correct it and give it with --map.
    Nothing that is there is overwritten.
    """
    from pdr_filter.io.describe import reading_report
    from pdr_filter.io.detection import detect
    from pdr_filter.io.files.archive import outside
    from pdr_filter.io.files.safe_files import write_text
    from pdr_filter.io.folders import only_recording_in
    from pdr_filter.io.formats import read
    from pdr_filter.io.tables.any_table import read_guessed, read_mapped
    from pdr_filter.io.tables.column_mapping import read_mapping

    with console.one_line_errors():
        if mapping is not None and platform is not None:
            raise ValueError("--map says the sign, too: leave --platform out")
        text = ""
        of_platform = None if platform is None else platform.value
        file = only_recording_in(file)
        if mapping is not None:
            recording = read_mapped(file, read_mapping(mapping))
        elif detect(file) == "table":
            found = read_guessed(file, of_platform)
            recording, text = found.recording, found.guess.mapping.toml()
        else:
            recording = read(file, platform=of_platform)
        to = out or outside(file.absolute())[0].with_name(f"{file_name(recording.name)}_recording.zip")
        beside = to.with_suffix(".toml") if to.suffix else to.with_name(f"{to.name}.toml")
        for path in (to, *([beside] if text else [])):
            if path.exists():
                raise ValueError(f"{path} is there already, and is not overwritten: give --out another name")
        for line in (*reading_report(recording).lines(), *([""] if text else [])):
            typer.echo(printable(line))
        typer.echo(printable_lines(text), nl=False)
        written = [recording.save(to)]
        if text:
            written.append(write_text(beside, text))
    for path in written:
        console.stderr().print(f"written: {console.escape(str(path))}")
