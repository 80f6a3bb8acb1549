"""Colours of all pictures are defined in one module."""

from __future__ import annotations

from pathlib import Path

from pdr_filter.apps.report import palette

ROOT = Path(__file__).resolve().parents[3]


def test_the_colours_of_figures_pages_notebooks_and_studies_stand_in_the_palette_alone() -> None:
    files = [
        *ROOT.glob("pdr_filter/apps/report/*.py"),
        *ROOT.glob("pdr_filter/apps/cli/*.py"),
        *ROOT.glob("notebooks/*.ipynb"),
    ]
    files += [*ROOT.glob("docs/images/*.py"), *ROOT.glob("tests/studies/*.py")]
    again = [
        f"{file.name}: {colour}"
        for file in files
        if file.name != "palette.py"
        for colour in (*palette.COLOURS, *palette.MORE_COLOURS, palette.INK, palette.ELLIPSE)
        if colour.lower() in source(file)
    ]
    assert len(files) > 20
    assert not again


def test_twelve_contexts_have_twelve_colours() -> None:
    colours = palette.context_colours(tuple(f"context {i}" for i in range(13)))
    assert len(set(colours.values())) == 12
    assert colours["context 12"] == colours["context 0"]
    assert list(palette.context_colours().values()) == list(palette.COLOURS)


def source(file: Path) -> str:
    """Return the text in lower case. Stored pictures of notebooks are removed, because they have other colours."""
    text = file.read_text(encoding="utf-8").lower()
    return "\n".join(line for line in text.splitlines() if '"image/' not in line and len(line) < 1000)
