"""Sphinx configuration.

Tables of models and lists of messages are made from model cards and source code when the documentation is built.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import sys
import textwrap
from dataclasses import is_dataclass
from importlib.metadata import files
from pathlib import Path
from typing import Any

from jinja2.sandbox import SandboxedEnvironment
from numpydoc import docscrape_sphinx
from sphinx.ext.autosummary import autosummary_toc

import pdr_filter

sys.path.insert(0, str(Path(__file__).parent))
import catalogue

# Public names of modules of data and applications, because autosummary imports modules by their name.
for name in ("batch", "datasets", "plot"):
    sys.modules.setdefault(f"pdr_filter.{name}", getattr(pdr_filter, name))

project = "pdr_filter"
author = "The pdr_filter developers"
copyright = f"2026, {author}"
version = release = pdr_filter.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.mathjax", "numpydoc"]
myst_enable_extensions = ["amsmath", "dollarmath", "substitution"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "tables"]  # pages include the tables
templates_path = ["_templates"]  # for the page of each object in docs/api.md
# A notebook runs again if it has changed or docs/_build was removed. A failing notebook breaks the build.
nb_execution_mode = "cache"
nb_execution_cache_path = str(Path(__file__).parent / "_build" / "notebooks")
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
nb_render_markdown_format = "myst"  # CommonMark has no tables, which `evaluate.markdown` writes
# Formulas work without a network: MathJax and its fonts are one local file.
(mathjax,) = (f for f in files("sphinx-mathjax-offline") or () if f.name == "tex-svg-full.js")
html_static_path = [str(mathjax.locate()), "_static"]
html_css_files = ["page.css"]
html_search_scorer = str(Path(__file__).parent / "_static" / "search_order.js")
mathjax_path = "tex-svg-full.js"
html_theme = "furo"
html_title = f"pdr_filter {version}"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {"FloatArray": "FloatArray", "ArrayLike": "ArrayLike", "Table": "Table"}
autodoc_preserve_defaults = True
numpydoc_show_class_members = False


def model_card(description: dict[str, Any]) -> str:
    """Return a heading and a table of one model."""
    card = description.get("card", {})
    scores = card.get("leave_one_subject_out", {})
    sites = card.get("site_left_out", {}).items()
    rows = {
        "classes": f"{', '.join(description['classes'])} ({description['head'].replace('_', ' ')})",
        "for": card.get("intended_use"),
        "limits": card.get("limits"),
        "trained on": f"{', '.join(card.get('data', []))}: {card.get('n_people')} people, "
        f"{sum(card.get('n_windows', {}).values()):,} windows, {card.get('n_features')} features",
        "held-out people": scores.get("people"),
        "accuracy, worst person": f"{scores.get('accuracy')}, {scores.get('worst_person_accuracy')}",
        "macro recall": scores.get("macro_recall"),
        "recall": shares(scores.get("recall", {})),
        "log loss, Brier score, calibration error": ", ".join(
            str(scores.get(key)) for key in ("log_loss", "brier", "expected_calibration_error")
        ),
        "held-out sites, recall": "; ".join(
            f"{site}: {shares(of_site.get('recall') or {'walking': of_site.get('walking_recall')})}"
            for site, of_site in sites
        ),
        "trained": f"`{card.get('command')}`, scikit-learn {card.get('versions', {}).get('scikit-learn')}",
    }
    lines = [f"| {key} | {value} |" for key, value in rows.items() if value not in (None, "")]
    return "\n".join([f"## {description['name']}", "", card.get("description", ""), "", "| | |", "|---|---|", *lines])


def shares(values: dict[str, float]) -> str:
    """Return names with numbers of two digits."""
    return ", ".join(f"{name} {value:.2f}" for name, value in values.items())


def model_table(descriptions: list[dict[str, Any]]) -> str:
    """Return a table of all context models with scores on held-out people."""
    columns = {"accuracy": "accuracy", "worst person": "worst_person_accuracy", "macro recall": "macro_recall"}
    columns |= {"log loss": "log_loss", "Brier": "brier", "ECE": "expected_calibration_error"}
    rows = []
    for description in descriptions:
        card = description.get("card", {})
        scores = card.get("leave_one_subject_out", {})
        if description["head"] == "context" and scores:
            name = f"`{description['name']}` ({card.get('n_features')})"
            rows.append(" | ".join([name, *(f"{scores.get(key, float('nan')):.3f}" for key in columns.values())]))
    head = " | ".join(["model (features)", *columns])
    return "\n".join([f"| {head} |", "|---" * (len(columns) + 1) + "|", *(f"| {row} |" for row in rows)])


models = Path(__file__).resolve().parents[1] / "models"
cards = sorted(path for path in models.glob("*.json") if path.with_suffix(".npz").is_file())
descriptions = [json.loads(path.read_text("utf-8")) for path in cards]
myst_substitutions = {
    "model_cards": "\n\n".join(map(model_card, descriptions)),
    "model_table": model_table(descriptions),
    "refusals": catalogue.refusal_lists(),
    "module_texts": catalogue.module_texts(),
    **{f"notes_{subject.replace(' ', '_')}": notes for subject, notes in catalogue.note_lists().items()},
}


def escape_bars(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Escape bars, because reStructuredText takes |f| for a substitution."""
    lines[:] = [line if line.lstrip().startswith((">>>", "...")) else line.replace("|", r"\|") for line in lines]


def has_fields_below(obj: Any) -> bool:
    """Return True for a dataclass whose docstring has neither Parameters nor Attributes."""
    return is_dataclass(obj) and not re.search("^ *(Parameters|Attributes)$", obj.__doc__ or "", re.MULTILINE)


def name_aliases(app: Any, what: str, name: str, obj: Any, options: Any, *texts: str | None) -> tuple[str | None, ...]:
    """Show type aliases such as FloatArray by their names, and no signature of a dataclass.

    The fields of a dataclass are in its docstring or below it.
    """
    if what == "class" and is_dataclass(obj):
        return "(...)", None
    return tuple(text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) for text in texts)


def append_fields(_app: Any, what: str, _name: str, obj: Any, _options: Any, lines: list[str]) -> None:
    """Append the source of the fields, with comments, to the docstring of a dataclass that does not describe them."""
    if what != "class" or not has_fields_below(obj):
        return
    body = [row for part in reversed(obj.__mro__) if "__dataclass_fields__" in vars(part) for row in declared(part)]
    if body:
        at = next((k for k, line in enumerate(lines) if line.startswith(".. rubric:: Examples")), len(lines))
        lines[at:at] = ["", ".. code-block:: python", "", *(f"    {row}" for row in body), ""]


def declared(of: type) -> list[str]:
    """Return the source lines of a dataclass that declare its own fields."""
    source = textwrap.dedent(inspect.getsource(of))
    declarations = [n for n in ast.parse(source).body[0].body if isinstance(n, ast.AnnAssign)]  # type: ignore[attr-defined]
    if not declarations:
        return []
    rows = source.splitlines()
    first = declarations[0].lineno - 1
    while rows[first - 1].lstrip().startswith("#"):
        first -= 1
    return [row[4:] for row in rows[first : declarations[-1].end_lineno] if row.strip()]


def remove_object_pages(_app: Any, doctree: Any) -> None:
    """Keep the pages of single objects out of the navigation; docs/api.md links to them.

    The theme computes the navigation again for each of 350 pages, which took two thirds of the build.
    """
    for node in list(doctree.findall(autosummary_toc)):
        node.parent.remove(node)


def reuse_navigation(_app: Any, page: str, _template: str, context: dict[str, Any], _doctree: Any) -> None:
    """Compute the navigation once for all pages of single objects.

    These pages are in one folder and are not in the navigation, so that it is the same on each of them. The theme
    computes it for each page, which took a quarter of the build.
    """
    if not page.startswith("api/"):
        return
    computed = context["toctree"]

    def reused(**options: Any) -> str:
        key = repr(sorted(options.items()))
        if key not in navigation:
            navigation[key] = computed(**options)
        return navigation[key]

    context["toctree"] = reused


def reused_environment(loader: Any) -> SandboxedEnvironment:
    """Return the first environment. numpydoc makes one for each docstring, and compiles its template in each."""
    return environments.setdefault("", SandboxedEnvironment(loader=loader))


environments: dict[str, SandboxedEnvironment] = {}
docscrape_sphinx.SandboxedEnvironment = reused_environment
navigation: dict[str, str] = {}  # navigation of object pages, by the options of the theme


def setup(app: Any) -> None:
    """Connect the functions above to events of Sphinx."""
    app.connect("doctree-read", remove_object_pages, priority=100)  # before the collection of toctrees
    app.connect("html-page-context", reuse_navigation, priority=400)  # before the theme
    app.connect("autodoc-process-signature", name_aliases)
    app.connect("autodoc-process-docstring", escape_bars, priority=900)  # after numpydoc
    app.connect("autodoc-process-docstring", append_fields, priority=950)  # after escape_bars
