"""Mutation check: how many small faults, put into the package one by one, the tests find.

usage: python -m tests.benchmarks.mutants [--n 60] [--seed 0] [--limit 300] [--out FILE.json]

Each mutant changes one operator, comparison, number or condition in one line of the package. The seed determines the
mutants. For each mutant, the fast tests in the folder that mirrors the module run in a copy of the tree until one
fails. A mutant that survives them all counts as alive. `timeout` means that the tests were still running after the
limit, in seconds: most of these mutants cause an endless loop.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
COMPARED = {"Lt": ast.LtE, "LtE": ast.Lt, "Gt": ast.GtE, "GtE": ast.Gt, "Eq": ast.NotEq, "NotEq": ast.Eq}
COMPUTED = {"Add": ast.Sub, "Sub": ast.Add, "Mult": ast.Div, "Div": ast.Mult}


@dataclass(frozen=True, slots=True)
class Mutant:
    """A fault in one line of a module."""

    module: str
    line: int
    number: int  # of the node in the module
    before: str
    after: str


def mutated(node: ast.AST) -> ast.AST | None:
    """A node with a small fault; None if there is none for it."""
    if isinstance(node, ast.Compare) and type(node.ops[0]).__name__ in COMPARED:
        return ast.Compare(node.left, [COMPARED[type(node.ops[0]).__name__](), *node.ops[1:]], node.comparators)
    if isinstance(node, ast.BinOp) and type(node.op).__name__ in COMPUTED:
        return ast.BinOp(node.left, COMPUTED[type(node.op).__name__](), node.right)
    if isinstance(node, ast.BoolOp):
        return ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return ast.Constant(2 * node.value + 1)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        return node.operand
    return None


def places(module: Path) -> list[tuple[int, ast.AST]]:
    """Nodes of a module that can have a fault, with their numbers."""
    tree = ast.parse(module.read_text())
    typed = {id(inner) for node in ast.walk(tree) for inner in annotation_nodes(node)}
    return [(k, node) for k, node in enumerate(ast.walk(tree)) if id(node) not in typed and mutated(node) is not None]


def annotation_nodes(node: ast.AST) -> list[ast.AST]:
    """All nodes of the annotations of a node: a fault there changes nothing."""
    of_node = [getattr(node, name, None) for name in ("annotation", "returns")]
    return [inner for top in of_node if isinstance(top, ast.AST) for inner in ast.walk(top)]


def drawn(n: int, seed: int) -> list[Mutant]:
    """So many mutants of the package, one at most of a line."""
    modules = sorted((ROOT / "pdr_filter").rglob("*.py"))
    all_places = [(module, number, node) for module in modules for number, node in places(module)]
    chosen: dict[tuple[Path, int], Mutant] = {}
    rng = random.Random(seed)
    while len(chosen) < n:
        module, number, node = rng.choice(all_places)
        line = int(getattr(node, "lineno", 0))
        fault = mutated(node)
        if fault is not None:
            name = module.relative_to(ROOT).as_posix()
            chosen[module, line] = Mutant(name, line, number, ast.unparse(node), ast.unparse(fault))
    return list(chosen.values())


def put_into(tree: Path, mutant: Mutant) -> str:
    """Write a mutant into a copy of the tree; returns what was there."""
    path = tree / mutant.module
    source = path.read_text()
    parsed = ast.parse(source)
    node = list(ast.walk(parsed))[mutant.number]
    lines = source.splitlines(keepends=True)
    start, end = int(getattr(node, "lineno", 0)) - 1, int(getattr(node, "end_lineno", 0)) - 1
    first, last = lines[start].encode(), lines[end].encode()
    column, end_column = int(getattr(node, "col_offset", 0)), int(getattr(node, "end_col_offset", 0))
    changed = first[:column] + f"({mutant.after})".encode() + last[end_column:]
    path.write_text("".join([*lines[:start], changed.decode(), *lines[end + 1 :]]))
    return source


def tests_of(module: str) -> list[str]:
    """Test files of the folder that mirrors a module; files named after the module come first, as they fail soonest."""
    folder = Path("tests", *Path(module).parts[1:-1])
    while not any((ROOT / folder).glob("test_*.py")) and folder != Path("tests"):
        folder = folder.parent
    words = set(Path(module).stem.split("_"))
    files = sorted((ROOT / folder).glob("test_*.py"), key=lambda p: (-len(words & set(p.stem.split("_"))), p.name))
    return [str(p.relative_to(ROOT)) for p in files]


def fate(tree: Path, mutant: Mutant, limit_s: float) -> str:
    """Whether tests find a mutant: killed, alive or timeout."""
    source = put_into(tree, mutant)
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:xdist", "-p", "no:cacheprovider", "-m", "not slow"]
    try:
        environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
        ran = subprocess.run(
            [*command, *tests_of(mutant.module)], cwd=tree, env=environment, timeout=limit_s, capture_output=True
        )
        return "alive" if ran.returncode == 0 else "killed"
    except subprocess.TimeoutExpired:
        return "timeout"
    finally:
        (tree / mutant.module).write_text(source)


def main() -> None:
    """Draw mutants, run the tests of each, and print what became of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=300.0)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    results: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".git", ".venv", "__pycache__"))
        (Path(folder) / "shared").symlink_to(ROOT.parent / "shared")
        for k, mutant in enumerate(drawn(arguments.n, arguments.seed)):
            became = fate(tree, mutant, arguments.limit)
            results.append({**asdict(mutant), "fate": became})
            print(f"{k + 1}/{arguments.n} {became}: {mutant.module}:{mutant.line} {mutant.before} -> {mutant.after}")
            if arguments.out:
                arguments.out.write_text(json.dumps(results, indent=1))
    print(dict(Counter(str(r["fate"]) for r in results)))


if __name__ == "__main__":
    main()
