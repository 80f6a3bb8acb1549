"""Command `pdr-filter map`, which joins the walks of a folder to a map of the building."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pdr_filter.cli import console
from pdr_filter.cli.console import escape
from pdr_filter.cli.options import Scheduler, origin_deg


def map_folder(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of recordings with Wi-Fi.")],
    out: Annotated[Path, typer.Option(help="Folder for the map, the plans, the radio maps and the report.")],
    origin: Annotated[
        str | None, typer.Option(metavar="LAT,LON", help="Position of the building in degrees, for true north.")
    ] = None,
    salt: Annotated[
        str | None, typer.Option("--hash", metavar="SALT", help="Hash the addresses of access points with this text.")
    ] = None,
    times: Annotated[
        bool, typer.Option("--times", help="Keep the names of the walks and the times of their steps.")
    ] = False,
    jobs: Annotated[int, typer.Option(help="Number of processes that track walks, or -1 for all cores.")] = 1,
    scheduler: Scheduler = None,
) -> None:
    """Join the walks of a folder to a map of the building, without a plan or a survey.

    Known positions are read from the file fixes.csv beside a recording. A run that was killed continues where it was.
    """
    import pdr_filter as pdr
    from pdr_filter.io.folders import recordings_in

    with console.one_line_errors():
        paths = [str(path) for path in recordings_in(folder)]
        if not paths:
            raise ValueError(f"{folder} has no recordings: give the folder that contains them")
        with console.progress("mapping"):
            found = pdr.map_walks(
                paths, origin=origin_deg(origin), salt=salt, cache=out / "cache", jobs=jobs, scheduler=scheduler
            )
        before = console.existing(out / "map" / "walk_map.json", out / "map.html")
        found.save(out / "map", times=times)
        found.write_report(out / "map.html")
        for group in range(found.n_groups):
            found.radio(group).save(out / f"radio_{group}")
            found.write_plan(out / f"plan_{group}.geojson", group)
    for group in range(found.n_groups):
        typer.echo(f"group {group}: {sum(w.group == group for w in found.walks)} walks")
    if found.n_groups > 1:
        typer.echo("several groups have no place in common: several buildings, or storeys without a connecting walk")
    for name, why in found.apart:
        typer.echo(f"apart: {name}: {why}")
    if found.moved_access_points:
        typer.echo(
            f"{len(found.moved_access_points)} access points were moved or move with people: not in the radio map"
        )
    console.stderr().print(f"written: {escape(str(out))}")
    console.say_replaced(before)
