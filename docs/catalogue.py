"""Messages of the package, collected from its source: notes of tracks and refusals of readers.

`docs/conf.py` puts them on the page docs/messages.md when the documentation is built, so that the page cannot differ
from the code. A part of a message that depends on the data is shown as an ellipsis.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path

DOCS = Path(__file__).resolve().parent
PACKAGE = DOCS.parent / "pdr_filter"
ANY = "…"
# Subjects of notes that are lists of texts, by the folder of their module. `Note` objects name their subject.
SUBJECTS = {
    "sensing": "samples",
    "data/io": "reading",
    "offline/smoothing": "smoothing",
    "offline/calibration": "calibration",
}


@dataclass(frozen=True)
class Message:
    """Text of a message with ellipses, and what it is about: the subject of a note, or the module of a reader."""

    about: str
    text: str


class Texts:
    """Texts of the string expressions in one module."""

    def __init__(self, tree: ast.Module, constants: dict[str, ast.expr]) -> None:
        self.constants = constants | _assignments(tree.body)
        self.nodes = list(ast.walk(tree))
        self.functions = [node for node in self.nodes if isinstance(node, ast.FunctionDef)]
        self.assigned = [
            (node.lineno, target, value)
            for node in self.nodes
            if isinstance(node, ast.Assign)
            for target, value in _pairs(node)
        ]

    def of(self, node: ast.expr, depth: int = 0) -> list[str]:
        """Texts that an expression may have; an ellipsis stands for a part that is known only at run time."""
        if depth > 9:
            return [ANY]
        match node:
            case ast.Constant(value=str(text)):
                return [text]
            case ast.JoinedStr(values=parts):
                return self._joined(parts, depth)
            case ast.BinOp(left=left, op=ast.Add(), right=right):
                return self._joined([left, right], depth)
            case ast.IfExp(body=body, orelse=other):
                return [text for part in (body, other) for text in self.of(part, depth + 1)]
            case ast.Subscript(value=ast.Dict(values=values)):
                return [text for part in values for text in self.of(part, depth + 1)]
            case ast.FormattedValue(value=ast.Name() | ast.Attribute() as value):
                return self.of(value, depth + 1)
            case ast.Name(id=name) | ast.Attribute(attr=name):
                value = self._local(node) if isinstance(node, ast.Name) else None
                value = value or self.constants.get(name)
                return self.of(value, depth + 1) if value is not None else [ANY]
        return [ANY]

    def _joined(self, parts: list[ast.expr], depth: int) -> list[str]:
        return ["".join(texts) for texts in product(*(self.of(part, depth + 1) for part in parts))]

    def _local(self, name: ast.Name) -> ast.expr | None:
        """Value that was assigned to a name last before its use, in the same function."""
        found = [
            (line, value)
            for function in self.functions
            if function.lineno <= name.lineno <= (function.end_lineno or 0)
            for line, target, value in self.assigned
            if function.lineno <= line < name.lineno and target == name.id
        ]
        return max(found, key=lambda pair: pair[0])[1] if found else None


def _pairs(node: ast.Assign) -> Iterator[tuple[str, ast.expr]]:
    for target in node.targets:
        if isinstance(target, ast.Name):
            yield target.id, node.value


def _assignments(body: list[ast.stmt]) -> dict[str, ast.expr]:
    """Names of a module that are assigned a string, with its expression."""
    kinds = (ast.Constant, ast.JoinedStr, ast.BinOp)
    pairs = [pair for node in body if isinstance(node, ast.Assign) for pair in _pairs(node)]
    return {name: value for name, value in pairs if isinstance(value, kinds)}


@cache
def messages() -> tuple[list[Message], list[Message]]:
    """Notes and refusals of the package, in the order of its files, each text once."""
    trees = {path: ast.parse(path.read_text("utf-8")) for path in sorted(PACKAGE.rglob("*.py"))}
    constants: dict[str, ast.expr] = {}
    for tree in trees.values():
        constants |= {name: value for name, value in _assignments(tree.body).items() if name.isupper()}
    notes: dict[str, Message] = {}
    refusals: dict[str, Message] = {}
    for path, tree in trees.items():
        texts, module = Texts(tree, constants), path.relative_to(PACKAGE).with_suffix("").as_posix()
        for node in texts.nodes:
            for found, about, expression in _of_node(node, module, texts):
                for text in map(_trimmed, texts.of(expression)):
                    if len(text.replace(ANY, "").split()) > 2:
                        (notes if found == "note" else refusals).setdefault(text, Message(about, text))
    return list(notes.values()), list(refusals.values())


def _of_node(node: ast.AST, module: str, texts: Texts) -> Iterator[tuple[str, str, ast.expr]]:
    """Kind, subject and expression of each message that a call makes."""
    match node:
        case ast.Call(func=ast.Name(id="Note"), args=[about, text]):
            yield "note", texts.of(about)[0], text
        case ast.Call(func=ast.Name(id="RecordingError"), args=[text]):
            yield "refusal", module, text
        case ast.Call(func=ast.Attribute(attr="append", value=values), args=[text]):
            name = values.attr if isinstance(values, ast.Attribute) else getattr(values, "id", "")
            subject = next((about for folder, about in SUBJECTS.items() if module.startswith(folder)), "")
            if subject and (name == "notes" or (name == "found" and _in_notes(node, texts))):
                yield "note", subject, text


def _in_notes(node: ast.Call, texts: Texts) -> bool:
    functions = (f for f in texts.functions if f.lineno <= node.lineno <= (f.end_lineno or 0))
    return any(function.name == "notes" for function in functions)


def _trimmed(text: str) -> str:
    """Text without the name of a file or stream before it, and with one ellipsis for adjacent values."""
    return re.sub(f"{ANY}+", ANY, text).removeprefix(f"{ANY}: ").strip()


def note_lists() -> dict[str, str]:
    """Markdown list of the notes on each subject."""
    notes, _ = messages()
    return {
        subject: "\n".join(f"- {_shown(note.text)}" for note in notes if note.about == subject)
        for subject in dict.fromkeys(note.about for note in notes)
    }


def refusal_lists() -> str:
    """Markdown lists of the refusals, under a heading for each module of the readers."""
    _, refusals = messages()
    modules = dict.fromkeys(message.about for message in refusals)
    return "\n\n".join(
        f"### `{module}`\n\n" + "\n".join(f"- {_shown(m.text)}" for m in refusals if m.about == module)
        for module in modules
    )


def module_texts() -> str:
    """Markdown headings and docstrings of all modules to which a page links, so that the links have targets."""
    pages = [page for page in sorted(DOCS.glob("**/*.md")) if not {"_build", "tables"} & set(page.parts)]
    names = {name for page in pages for name in re.findall(r"\{mod\}`([\w.]+)`", page.read_text("utf-8"))}
    return "\n\n".join(
        f"### `{name}`\n\n```{{eval-rst}}\n.. automodule:: {name}\n   :no-members:\n```" for name in sorted(names)
    )


def _shown(text: str) -> str:
    """Text as code, so that no character of it is markup."""
    return f"`` {' '.join(text.split())} ``"
