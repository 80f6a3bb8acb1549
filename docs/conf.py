"""Sphinx configuration; the table of models is made from their cards when the documentation is built."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pdr_filter

project = "pdr_filter"
author = "The pdr_filter developers"
copyright = f"2026, {author}"
version = release = pdr_filter.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "numpydoc"]
myst_enable_extensions = ["amsmath", "dollarmath", "substitution"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"pdr_filter {version}"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {"FloatArray": "FloatArray", "ArrayLike": "ArrayLike", "Table": "Table"}
autodoc_preserve_defaults = True
numpydoc_show_class_members = False


def model_card(description: dict[str, Any]) -> str:
    """One model as a heading and a table."""
    card = description.get("card", {})
    scores = card.get("leave_one_subject_out", {})
    sites = card.get("site_left_out", {}).items()
    rows = {
        "classes": f"{', '.join(description['classes'])} ({description['head'].replace('_', ' ')})",
        "for": card.get("intended_use"),
        "limits": card.get("limits"),
        "trained on": f"{', '.join(card.get('data', []))}: {card.get('n_people')} people, "
        f"{sum(card.get('n_windows', {}).values()):,} windows, {card.get('n_features')} features",
        "people left out": scores.get("people"),
        "accuracy, worst person": f"{scores.get('accuracy')}, {scores.get('worst_person_accuracy')}",
        "macro recall": scores.get("macro_recall"),
        "recall": shares(scores.get("recall", {})),
        "log loss, Brier score, calibration error": ", ".join(
            str(scores.get(key)) for key in ("log_loss", "brier", "expected_calibration_error")
        ),
        "site left out, recall": "; ".join(
            f"{site}: {shares(of_site.get('recall') or {'walking': of_site.get('walking_recall')})}"
            for site, of_site in sites
        ),
        "made": f"{card.get('date')}, scikit-learn {card.get('versions', {}).get('scikit-learn')}",
    }
    lines = [f"| {key} | {value} |" for key, value in rows.items() if value not in (None, "")]
    return "\n".join([f"## {description['name']}", "", card.get("description", ""), "", "| | |", "|---|---|", *lines])


def shares(values: dict[str, float]) -> str:
    """Names with numbers of two digits."""
    return ", ".join(f"{name} {value:.2f}" for name, value in values.items())


models = Path(__file__).resolve().parents[1] / "models"
cards = sorted(path for path in models.glob("*.json") if path.with_suffix(".npz").is_file())
myst_substitutions = {"model_cards": "\n\n".join(model_card(json.loads(path.read_text("utf-8"))) for path in cards)}


def escape_bars(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Keep |f| a magnitude: in reStructuredText it would be a substitution."""
    lines[:] = [line if line.lstrip().startswith((">>>", "...")) else line.replace("|", r"\|") for line in lines]


def name_aliases(app: Any, what: str, name: str, obj: Any, options: Any, *texts: str | None) -> tuple[str | None, ...]:
    """Show FloatArray as FloatArray: Sphinx wraps the names of type aliases that it may not evaluate."""
    return tuple(text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) for text in texts)


def setup(app: Any) -> None:
    """Connect the hooks."""
    app.connect("autodoc-process-signature", name_aliases)
    app.connect("autodoc-process-docstring", escape_bars, priority=900)  # after numpydoc
