"""The layers of CONTRIBUTING.md, read off the source; and what --help must not load."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterable, Mapping, Set
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "posetrack_cli"
LAYERS = (
    "cli",
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
    return name.split(".")[1 if name in MODULES and name != PACKAGE.name else 0]


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys; from posetrack_cli.cli.main import run; "
        "codes = [run(line.split()) for line in ('--help', '--version', 'hand run --help')]; "
        f"print('LOADED', codes, sorted({HEAVY!r} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "LOADED [0, 0, 0] []", done.stderr
