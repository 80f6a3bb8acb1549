"""Command `pdr-filter map`, which joins the walks of a folder to a map of the building."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pdr_filter.apps.cli import console
from pdr_filter.apps.cli.options import Scheduler, origin_deg

if TYPE_CHECKING:
    from pdr_filter.apps.walk_map.walk_map import WalkMap


def map_command(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder of recordings with Wi-Fi, or one recording.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the map, the plans, the radio maps and the report.")],
    origin: str | None = typer.Option(
        None, metavar="LAT,LON", help="Position of the building in degrees, for true north."
    ),
    salt: str | None = typer.Option(
        None, "--hash", metavar="SALT", help="Hash the addresses of access points with this text."
    ),
    times: bool = typer.Option(
        False, "--times", help="Keep the names of the walks in all files, and the times of their steps in the map."
    ),
    jobs: int = typer.Option(1, help="Number of processes that track walks, or -1 for all cores."),
    scheduler: Scheduler = None,
) -> None:
    """Join the walks of a folder to a map of the building, without a plan or a survey.

    Known positions are read from the marks of a recording: walk.zip.marks/fixes.csv for the file walk.zip, and
    fixes.csv inside a recording that is a folder, with columns time_s, east_m, north_m and optionally std_m, floor,
    heading_deg and heading_std_deg. A run that was killed continues where it was.
    """
    import pdr_filter as pdr
    from pdr_filter.apps.maps.marks import unused_fixes

    with console.one_line_errors():
        paths = console.recording_paths([folder])
        console.say_unused_fixes(unused_fixes(paths))
        with console.progress("mapping"):
            found = pdr.map_walks(
                map(str, paths),
                origin=origin_deg(origin),
                salt=salt,
                cache=out / "cache",
                jobs=jobs,
                scheduler=scheduler,
            )
        for name, why in found.apart:
            console.print_line(f"apart: {name}: {why}")
        for note in found.notes:
            console.print_line(f"note: {note}")
        if not found.n_groups:
            raise ValueError("no map was written, because no walk could be joined: see the lines that begin with apart")
        for group in range(found.n_groups):
            typer.echo(f"group {group}: {sum(w.group == group for w in found.walks)} walks")
        if found.n_groups > 1:
            typer.echo(
                "several groups have no place in common: several buildings, storeys without a connecting walk, or too "
                "few walks in between"
            )
        if found.moved_access_points:
            typer.echo(
                f"{len(found.moved_access_points)} access points were moved or move with people: not in the radio map"
            )
        _write(found, out, times)


def _write(found: WalkMap, out: Path, times: bool) -> None:
    """Write a map with its report, radio maps and plans to a folder, and remove those of an earlier map.

    Without `times` no file has names of walks.
    """
    import pdr_filter as pdr
    from pdr_filter.classifiers.model_files import file_pair

    report, groups = out / "map.html", range(found.n_groups)
    pages = [report, *(path for k in groups for path in (*file_pair(out / f"radio_{k}"), out / f"plan_{k}.geojson"))]
    before, removed = console.existing(out / "map", *pages), sorted(_files_of_groups(out) - set(pages))
    found.save(out / "map", times=times)
    for path in removed:
        path.unlink()
    if not times:
        found = pdr.WalkMap.load(out / "map")
    found.write_report(report)
    for group in groups:
        found.radio(group).save(out / f"radio_{group}")
        found.write_plan(out / f"plan_{group}.geojson", group)
    console.say(f"written: {out}")
    console.say_replaced(before)
    if removed:
        console.say(f"removed files of an earlier map: {', '.join(map(str, removed))}")


def _files_of_groups(out: Path) -> set[Path]:
    """Return the radio maps and plans of the map in a folder. The set is empty without a map."""
    if not (out / "map" / "walk_map.json").exists():
        return set()
    names = re.compile(r"radio_\d+\.(json|npz)|plan_\d+\.geojson")
    return {path for path in out.iterdir() if names.fullmatch(path.name)}
