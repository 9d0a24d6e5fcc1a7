"""Layers (docs/architecture.md) as imported, declared dependencies, and what --help must not load."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Mapping, Set
from functools import cache
from graphlib import TopologicalSorter
from importlib.metadata import packages_distributions
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "posetrack_cli"
LAYERS = (
    "cli",
    "api",
    "batch",
    "evaluation",
    "synthesis",
    "hand",
    "head",
    "tracking",
    "filtering",
    "rendering",
    "results",
    "recording",
    "bags",
    "mcap",
    "geometry",
)
"""Packages, each above those that it may import from; single modules lie below all of them."""
FILES = {"os", "io", "pathlib", "shutil", "tempfile"}
HEAVY = {"numpy", "scipy", "cv2", "av", "pydantic", "mcap", "moderngl", "google.protobuf", "jinja2"}
PART_OF = {"pydantic_core": "pydantic", "markupsafe": "jinja2"}
"""Modules of a library that come with another one, whose interface they are part of."""
MODULES = {
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"): path
    for path in PACKAGE.rglob("*.py")
}


@cache
def trees() -> Mapping[str, ast.Module]:
    return {name: ast.parse(path.read_text()) for name, path in MODULES.items()}


@cache
def used() -> Mapping[str, Set[str]]:
    """What each module imports anywhere."""
    return {name: imported(ast.walk(tree)) for name, tree in trees().items()}


def test_imports_lead_downwards() -> None:
    used_at_once = {name: imported(tree.body) for name, tree in trees().items()}
    arrows = arrows_of(used())
    assert not {(a, b) for a, b in arrows if b in LAYERS and a not in LAYERS[: LAYERS.index(b) + 1]}
    assert not {("hand", "head"), ("head", "hand")} & arrows
    of_filters = {b for a, b in arrows if a == "filtering"}
    assert of_filters - sys.stdlib_module_names <= {"filtering", "arrays", "errors", "numpy"}
    assert not of_filters & FILES
    assert {b for a, b in arrows_of(used_at_once) if a == "cli"} & {*LAYERS, *HEAVY} == {"cli"}
    assert {path.parent.name for path in PACKAGE.glob("*/*.py")} == set(LAYERS)


def test_imports_make_no_circle() -> None:
    TopologicalSorter({name: names & MODULES.keys() for name, names in used().items()}).prepare()


def arrows_of(imports: Mapping[str, Set[str]]) -> set[tuple[str, str]]:
    """From which layer, or module below all, imports lead to which, or to which library."""
    return {(layer(name), layer(other)) for name, others in imports.items() for other in others}


def imported(nodes: Iterable[ast.AST]) -> set[str]:
    """Full names of the modules that statements import."""
    names: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            inside = [f"{node.module}.{alias.name}" for alias in node.names]
            names |= {name if name in MODULES else str(node.module) for name in inside}
    return names


def layer(name: str) -> str:
    """The layer that a module is in, itself if it lies below all, or the library's name."""
    if name == f"{PACKAGE.name}.__main__":
        return "cli"
    if name == PACKAGE.name:  # its names are those of the Python interface
        return "api"
    return name.split(".")[1 if name in MODULES and name != PACKAGE.name else 0]


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys; from posetrack_cli.cli.main import run; "
        "codes = [run(line.split()) for line in ('--help', '--version', 'hand run --help')]; "
        f"print('LOADED', codes, sorted({HEAVY!r} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "LOADED [0, 0, 0] []", done.stderr


def test_what_is_imported_is_a_declared_dependency() -> None:
    """A library that happens to come with another one is missing as soon as that one is dropped."""
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    optional = ("batch", "c3d", "nwb", "parquet", "tables")
    installed = [*project["dependencies"], *(one for extra in optional for one in extras[extra])]
    assert not imported_in("posetrack_cli") - names_of(installed)
    assert not imported_in("tests", "scripts") - names_of([*installed, *extras["dev"]])


def names_of(requirements: Iterable[str]) -> set[str]:
    """Normalized names of distributions."""
    return {normalized(re.split(r"[<>=!~\[; ]", requirement)[0]) for requirement in requirements}


def normalized(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def imported_in(*folders: str) -> set[str]:
    """Distributions whose modules the Python files of folders import."""
    installed = packages_distributions()
    found: set[str] = set()
    for path in (path for folder in folders for path in (PACKAGE.parent / folder).rglob("*.py")):
        tops = {name.split(".")[0] for name in imported(ast.walk(ast.parse(path.read_text())))}
        for top in tops - sys.stdlib_module_names - {PACKAGE.name}:
            found |= {normalized(PART_OF.get(top, one)) for one in installed.get(top, [])}
    return found
