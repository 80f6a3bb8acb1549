"""Runs the command as somebody would."""

from __future__ import annotations

from typer.testing import CliRunner, Result

from pdr_filter.cli.app import app


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "200", "TERM": "dumb"})


def one_line(text: str) -> str:
    """The only line of a message; no traceback."""
    (line,) = text.strip().splitlines()
    return line
