"""Command `pdr-filter plan`, which shows how a floor plan is interpreted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pdr_filter.apps.cli import console
from pdr_filter.apps.cli.options import AsJson, Folder
from pdr_filter.values.sanitise import file_name, printable

if TYPE_CHECKING:
    from pdr_filter.apps.maps.floor_plan import FloorPlan


def plan_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Floor plan as GeoJSON, in metres or in degrees.")],
    out: Folder = None,
    as_json: AsJson = False,
) -> None:
    """Show how a floor plan is interpreted, and draw it as NAME.png into the folder of --out."""
    import pdr_filter as pdr

    with console.one_line_errors():
        read = pdr.FloorPlan.read(file)
        picture = None if out is None else out / f"{file_name(read.name)}.png"
        before = console.existing(picture)
        if picture is not None:
            pdr.plot.plan(read, picture)
    if as_json:
        console.print_json(read.summary())
    else:
        _print(read)
    console.say_written(out)
    console.say_replaced(before)


def _print(plan: FloorPlan) -> None:
    from pdr_filter.values import how_many

    typer.echo(printable(f"{plan.name}: {how_many(len(plan.storeys), 'storey')}"))
    table = console.new_table("floor", "east-west", "north-south", "outline", "walkable area", "features")
    for storey in (s.summary() for s in plan.storeys):
        table.add_row(
            str(storey["floor"]),
            f"{storey['width_m']:.1f} m",
            f"{storey['height_m']:.1f} m",
            "drawn" if storey["has_outline"] else "hull of the walls",
            f"{storey['walkable_m2']:.0f} m2",
            ", ".join(f"{n} {kind}" for kind, n in storey["features"].items()),
        )
    console.print_table(table)
    for note in plan.notes:
        typer.echo(printable(f"note: {note}"))
