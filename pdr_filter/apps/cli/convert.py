"""Command `pdr-filter convert`, which converts a file of any app to a recording and explains the column mapping."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pdr_filter.apps.cli import console
from pdr_filter.apps.cli.options import Platform
from pdr_filter.values.sanitise import file_name, printable, printable_lines

if TYPE_CHECKING:
    from pdr_filter.values.recording import Recording


def convert_command(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...", help="File or folder of any app. Several are parts of one recording, which are joined."
        ),
    ],
    mapping: Path | None = typer.Option(
        None, "--map", help="TOML file with the column mapping. Default: the mapping is guessed."
    ),
    platform: Platform = None,
    out: Path | None = typer.Option(None, help="Output file. Default: NAME_recording.zip next to the first FILE."),
) -> None:
    """Convert a file to a recording, or join files that were cut in time, and show the column mapping.

    The column mapping of a table is written next to the recording, as NAME_recording.toml. If a column is mapped
    wrongly, correct this file and pass it with --map. Existing files are never overwritten. Of several files, the
    mapping is written only if it fits each of them.
    """
    from pdr_filter.data.io.describe import reading_report
    from pdr_filter.data.io.detection import detect
    from pdr_filter.data.io.files.archive import outside
    from pdr_filter.data.io.folders import only_recording_in
    from pdr_filter.data.io.formats import read
    from pdr_filter.data.io.joined import joined
    from pdr_filter.data.io.tables.any_table import read_guessed, read_mapped
    from pdr_filter.data.io.tables.column_mapping import read_mapping
    from pdr_filter.values.safe_files import write_text

    with console.one_line_errors():
        if mapping is not None and platform is not None:
            raise ValueError(
                f"--platform {platform} and --map {mapping} both set the sign of the acceleration: omit --platform"
            )
        texts: dict[Path, str] = {}  # mappings of the files that are tables
        parts: list[Recording] = []
        files = [only_recording_in(file) for file in files]
        for file in files:
            if mapping is not None:
                parts.append(read_mapped(file, read_mapping(mapping)))
            elif detect(file) == "table":
                found = read_guessed(file, platform)
                parts.append(found.recording)
                texts[file] = found.guess.mapping.toml()
            else:
                parts.append(read(file, platform=platform))
        recording = joined(parts)
        fits_all = len(texts) == len(files) and len(set(texts.values())) == 1
        text = texts[files[0]] if fits_all else ""
        to = out or outside(files[0].absolute())[0].with_name(f"{file_name(recording.name)}_recording.zip")
        mapping_path = to.with_suffix(".toml") if to.suffix else to.with_name(f"{to.name}.toml")
        for path in (to, *([mapping_path] if text else [])):
            if path.exists():
                raise ValueError(
                    f"{path} already exists, and convert does not overwrite files: give --out another name"
                )
        for line in (*reading_report(recording).lines(), *([""] if text else [])):
            typer.echo(printable(line))
        typer.echo(printable_lines(text), nl=False)
        written = [recording.save(to)]
        if text:
            written.append(write_text(mapping_path, text))
    for path in written:
        console.say(f"written: {path}")
    if texts and not fits_all:
        console.say(
            f"no column mapping was written, because none fits each of the {len(files)} files: convert them one by one "
            "to see and correct the mapping of each"
        )
