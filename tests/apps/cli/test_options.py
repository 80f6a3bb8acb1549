"""Option groups: dataclasses as parameters of a command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from pdr_filter.apps.cli.options import in_groups


@dataclass(frozen=True)
class Size:
    width_m: Annotated[float, typer.Option("--width", min=0.0, help="How wide.")] = 1.0
    is_round: Annotated[bool, typer.Option("--round")] = False


def draw(name: str, size: Size, colour: Annotated[str, typer.Option()] = "red") -> None:
    """Draw it."""
    typer.echo(f"{name} {size} {colour}")


@pytest.fixture
def app() -> typer.Typer:
    app = typer.Typer()
    app.command()(in_groups(draw))
    return app


def test_a_group_is_filled_from_its_options_and_their_defaults(app: typer.Typer) -> None:
    assert CliRunner().invoke(app, ["box"]).output == f"box {Size()} red\n"
    given = CliRunner().invoke(app, ["box", "--width", "2.5", "--round", "--colour", "blue"]).output
    assert given == f"box {Size(2.5, True)} blue\n"


def test_options_of_a_group_keep_their_help_their_limits_and_the_commands_own_words(app: typer.Typer) -> None:
    shown = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "120", "TERM": "dumb"}).output
    assert "Draw it." in shown
    assert shown.index("--width") < shown.index("--round") < shown.index("--colour")
    assert "How wide." in shown
    assert CliRunner().invoke(app, ["box", "--width", "-1"]).exit_code == 2
