"""Mutation check: how many small faults, put into the package one by one, the tests find.

usage: python -m tests.benchmarks.mutants [--n 60] [--seed 0] [--only 3 17] [--limit 600] [--reached FILE] [--out FILE]

Each mutant changes one operator, comparison, number or condition in one line of the package. The seed determines the
mutants. The fast tests run once in a copy of the tree that records which test evaluates which of these places. For each
mutant, these tests run until one fails: first those of the folder that mirrors the module, then the others, the
quickest first. A mutant that survives them all counts as alive, even if a slow test would find it. A place outside of
functions is evaluated when the module is imported and counts as reached by all tests. `timeout` means that the tests
were still running after the limit, in seconds: most of these mutants cause an endless loop. `--reached` keeps the
record of the first run in a file, or uses it if it exists.
"""

from __future__ import annotations

import argparse
import ast
import builtins
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pytest

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


# --- the tests that reach a mutant ------------------------------------------------------------------------------------

# With this variable, the module is a plugin of pytest that records reached mutants in a file, one test a line.
REACHED_FILE = "MUTANTS_REACHED"
_RECORD = "_record_mutant"
_seen: set[int] = set()


class _Recording(ast.NodeTransformer):
    """Add a record of each evaluation to some nodes of a module."""

    def __init__(self, number_of: dict[int, int]) -> None:
        self.number_of = number_of  # numbers of the mutants, by the identity of the syntax node

    def visit(self, node: ast.AST) -> ast.AST:
        """Return `record(number) or node` for a node of a mutant. A process of another program records nothing."""
        node = self.generic_visit(node)
        if id(node) not in self.number_of or not isinstance(node, ast.expr):
            return node
        record = f"getattr(__import__('builtins'), '{_RECORD}', lambda _: None)({self.number_of[id(node)]})"
        return ast.BoolOp(ast.Or(), [ast.parse(record, mode="eval").body, node])


def with_records(source: str, number_of: dict[int, int]) -> str:
    """Return the source of a module that records evaluations of nodes, given the number of the mutant of each."""
    tree = ast.parse(source)
    nodes = list(ast.walk(tree))
    of_node = {id(nodes[number]): mutant for number, mutant in number_of.items()}
    return ast.unparse(ast.fix_missing_locations(_Recording(of_node).visit(tree)))


if REACHED_FILE in os.environ:
    setattr(builtins, _RECORD, _seen.add)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
        """Append the test, its seconds of CPU and the mutants that it reaches to the file."""
        with Path(os.environ[REACHED_FILE]).open("a") as file:
            _seen.clear()
            start = sum(os.times()[:4])
            result = yield
            name = item.nodeid.partition("[")[0]
            file.write(json.dumps([name, round(sum(os.times()[:4]) - start, 3), sorted(_seen)]) + "\n")
        return result


def fast_tests(tree: Path, *arguments: str) -> dict[str, Any]:
    """Arguments of `subprocess.run` for the fast tests of a tree, in one process."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "-p", "no:cacheprovider", "-m", "not slow"]
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    return {"args": [*command, *arguments], "cwd": tree, "env": environment, "capture_output": True}


def record_reached(tree: Path, mutants: list[Mutant], out: Path) -> None:
    """Run the fast tests once and write which of them reach which mutants."""
    sources: dict[Path, str] = {}
    for module in {mutant.module for mutant in mutants}:
        path = tree / module
        sources[path] = path.read_text()
        number_of = {mutant.number: k for k, mutant in enumerate(mutants) if mutant.module == module}
        path.write_text(with_records(sources[path], number_of))
    run = fast_tests(tree, "-p", "tests.benchmarks.mutants")
    run["env"][REACHED_FILE] = str(out.resolve())
    ran = subprocess.run(**run)
    for path, source in sources.items():
        path.write_text(source)
    if not out.exists():
        raise RuntimeError(f"no test ran:\n{ran.stdout.decode()}")


def reaching_tests(reached: Path, mutants: list[Mutant]) -> list[list[str]]:
    """Test functions that reach each mutant, in the order in which they run."""
    cpu_s: Counter[str] = Counter()
    tests: list[set[str]] = [set() for _ in mutants]
    for line in reached.read_text().splitlines():
        name, seconds, numbers = json.loads(line)
        cpu_s[name] += seconds
        for k in numbers:
            tests[k].add(name)
    for k, mutant in enumerate(mutants):  # processes of other programs are not recorded: add the tests of the folder
        files, by_all = tests_of(mutant.module), is_at_import(mutant)
        tests[k] |= {name for name in cpu_s if by_all or name.partition("::")[0] in files}
    return [
        sorted(names, key=lambda name: (likelihood(name.partition("::")[0], mutant.module), cpu_s[name]))
        for names, mutant in zip(tests, mutants, strict=True)
    ]


def is_at_import(mutant: Mutant) -> bool:
    """Return True if the place of a mutant is in no body of a function."""
    nodes = list(ast.walk(ast.parse((ROOT / mutant.module).read_text())))
    functions = [node for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    inside = {id(inner) for f in functions for statement in f.body for inner in ast.walk(statement)}
    return id(nodes[mutant.number]) not in inside


def tests_of(module: str) -> list[str]:
    """Test files of the folder that mirrors a module."""
    folder = Path("tests", *Path(module).parts[1:-1])
    while not any((ROOT / folder).glob("test_*.py")) and folder != Path("tests"):
        folder = folder.parent
    return [str(path.relative_to(ROOT)) for path in (ROOT / folder).glob("test_*.py")]


def likelihood(file: str, module: str) -> tuple[bool, int]:
    """Sort key of test files: the folder of the module first, and in it the words that the names share."""
    words = set(Path(module).stem.split("_")) & set(Path(file).stem.split("_"))
    return file not in tests_of(module), -len(words)


def fate(tree: Path, mutant: Mutant, tests: list[str], limit_s: float) -> str:
    """Return what the tests make of a mutant: killed, with the failed test, alive or timeout."""
    source = put_into(tree, mutant)
    given = tree.parent / "tests.txt"  # more names than a command line holds
    given.write_text("\n".join(tests))
    try:
        ran = subprocess.run(**fast_tests(tree, "-x", f"@{given}"), timeout=limit_s)
        failed = [line for line in ran.stdout.decode().splitlines() if line.startswith(("FAILED", "ERROR"))]
        return "alive" if ran.returncode in (0, 5) else f"killed by {failed[0].split(' ')[1]}" if failed else "killed"
    except subprocess.TimeoutExpired:
        return "timeout"
    finally:
        (tree / mutant.module).write_text(source)


def main() -> None:
    """Draw mutants, run the tests of each, and print what became of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, nargs="+", help="numbers of the mutants to run, from 1")
    parser.add_argument("--limit", type=float, default=600.0)
    parser.add_argument("--reached", type=Path)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    results: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".git", ".venv", "__pycache__"))
        (Path(folder) / "shared").symlink_to(ROOT.parent / "shared")
        mutants = drawn(arguments.n, arguments.seed)
        reached = arguments.reached or Path(folder) / "reached.jsonl"
        if not reached.exists():
            record_reached(tree, mutants, reached)
        tests = reaching_tests(reached, mutants)
        for number in arguments.only or range(1, arguments.n + 1):
            mutant, start = mutants[number - 1], time.perf_counter()
            became = fate(tree, mutant, tests[number - 1], arguments.limit)
            results.append({**asdict(mutant), "fate": became})
            about = f"{mutant.module}:{mutant.line} {mutant.before} -> {mutant.after}"
            print(f"{number} {became}: {about} ({time.perf_counter() - start:.0f} s)", flush=True)
            if arguments.out:
                arguments.out.write_text(json.dumps(results, indent=1))
    print(dict(Counter(str(r["fate"]).split(" ")[0] for r in results)))


if __name__ == "__main__":
    main()
