"""Wheels of all dependencies on each supported system and Python, as pip finds them.

usage: python -m tests.benchmarks.wheels

Asks the package index for the newest version of each dependency of pyproject.toml, without downloading the wheels. It
ends with an error if a required package has no wheel on a system on which its environment marker demands it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from packaging.requirements import Requirement

from tests.benchmarks.common import Tables, run

ROOT = Path(__file__).resolve().parents[2]
PYTHONS = ("3.11", "3.12", "3.13")
# The tags of pip, and the values of the environment markers sys_platform and platform_machine. The systems are the
# oldest that the newest wheels of numpy and scipy support.
SYSTEMS = {
    "Linux x86-64": (("manylinux2014_x86_64", "manylinux_2_28_x86_64"), "linux", "x86_64"),
    "Linux ARM": (("manylinux2014_aarch64", "manylinux_2_28_aarch64"), "linux", "aarch64"),
    "macOS ARM": (("macosx_14_0_arm64",), "darwin", "arm64"),
    "macOS Intel": (("macosx_14_0_x86_64",), "darwin", "x86_64"),
    "Windows": (("win_amd64",), "win32", "AMD64"),
}
# Packages that pip compiles where they have no wheel, in less than a minute, which needs a C++ compiler alone.
COMPILED_BY_PIP = {("Linux ARM", "vqf")}
EXTRAS = ("app", "live", "maps", "parquet", "excel", "ros", "hdf5", "datasets", "cluster")  # the extras for users


def requirements() -> dict[str, list[Requirement]]:
    """Return the requirements of the package under "", and those of each extra for users under its name."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    listed = {"": project["dependencies"], **{extra: project["optional-dependencies"][extra] for extra in EXTRAS}}
    parsed = {extra: [Requirement(text) for text in texts] for extra, texts in listed.items()}
    return {extra: [each for each in of if each.name != "pdr_filter"] for extra, of in parsed.items()}


def wheels(names: list[str], system: str, python: str) -> dict[str, str]:
    """Return the file names of the newest wheels that pip finds, by the name of the requirement."""
    tags = [f"--platform={tag}" for tag in SYSTEMS[system][0]]
    options = ["--dry-run", "--quiet", "--ignore-installed", "--no-deps", "--only-binary=:all:", "--report=-"]
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", *options, *tags]
    # pip refuses the option --platform without a target; a dry run does not write to it
    done = subprocess.run(
        [*command, f"--python-version={python}", "--target=unused", *names], capture_output=True, text=True
    )
    if done.returncode == 0:
        return {
            each["metadata"]["name"].lower().replace("_", "-"): each["download_info"]["url"].rsplit("/", 1)[-1]
            for each in json.loads(done.stdout)["install"]
        }
    if "No matching distribution" not in done.stderr:
        raise SystemExit(f"{system}, Python {python}: pip failed, but no wheel is missing\n{done.stderr}")
    if len(names) == 1:
        return {}
    middle = len(names) // 2  # halves, until the packages without a wheel are alone
    return wheels(names[:middle], system, python) | wheels(names[middle:], system, python)


def rows(found: dict[tuple[str, str], dict[str, str]], of: dict[str, list[Requirement]]) -> Iterator[list[str]]:
    """Yield the rows of the table: one for each compiled package, and one for all others."""
    pure: list[str] = []
    for name, extras in by_name(of).items():
        files = {key: each.get(name, "") for key, each in found.items()}
        if all(file.endswith("-none-any.whl") for file in files.values()):
            pure.append(name)
            continue
        cells: list[str] = []
        for system in SYSTEMS:
            has = [python for python in PYTHONS if files[system, python]]
            cells.append("yes" if len(has) == len(PYTHONS) else ", ".join(has) or "**no**")
        yield [f"`{name}`", ", ".join(f"`{extra}`" for extra in extras) or "always", *cells]
    yield [f"{len(pure)} others, pure Python", "", *["yes"] * len(SYSTEMS)]


def by_name(of: dict[str, list[Requirement]]) -> dict[str, list[str]]:
    """Return the extras that need each package, by its normalised name; an empty list for required ones."""
    extras: dict[str, list[str]] = {}
    for extra, each in of.items():
        for requirement in each:
            name = requirement.name.lower().replace("_", "-")
            extras.setdefault(name, [])
            if extra:
                extras[name].append(extra)
    required = {requirement.name.lower().replace("_", "-") for requirement in of[""]}
    return {name: [] if name in required else listed for name, listed in extras.items()}


def missing(found: dict[tuple[str, str], dict[str, str]], required: list[Requirement]) -> list[str]:
    """Return the required packages without a wheel where their environment markers demand them."""
    lines: list[str] = []
    for (system, python), files in found.items():
        _, sys_platform, machine = SYSTEMS[system]
        environment = {"sys_platform": sys_platform, "platform_machine": machine, "python_version": python}
        lines += [
            f"{each.name}: no wheel for {system}, Python {python}"
            for each in required
            if (each.marker is None or each.marker.evaluate(environment))
            and each.name.lower().replace("_", "-") not in files
            and (system, each.name) not in COMPILED_BY_PIP
        ]
    return lines


def wheels_of_systems(tables: Tables, _: argparse.Namespace) -> None:
    """Packages that are compiled, and the systems that have wheels of them."""
    of = requirements()
    # without markers, because pip evaluates them for the system on which it runs; the lower bounds stay
    names = sorted({f"{each.name}{each.specifier}" for listed in of.values() for each in listed})
    cells = [(system, python) for system in SYSTEMS for python in PYTHONS]
    with ThreadPoolExecutor(2) as pool:
        found = dict(zip(cells, pool.map(lambda cell: wheels(names, *cell), cells), strict=True))
    about = f"yes: wheels for Python {', '.join(PYTHONS)}."
    tables.write("wheels", ["package", "needed by", *SYSTEMS], list(rows(found, of)), about)
    if absent := missing(found, of[""]):
        raise SystemExit("\n".join([*absent, "give these packages an environment marker in pyproject.toml"]))


if __name__ == "__main__":
    run(__doc__, wheels_of_systems)
