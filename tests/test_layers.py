"""Who may import whom: the layers of CONTRIBUTING.md, read off the source; and what --help must not load."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "posetrack_cli"
LAYERS = (
    "cli",
    "evaluation",
    "synthesis",
    "hand",
    "head",
    "tracking",
    "filtering",
    "rendering",
    "results",
    "recording",
    "mcap",
    "geometry",
)
APART = {"hand": "head", "head": "hand"}
"""Beside each other: neither knows the other."""
BELOW_ALL = {
    "": {"limits"},
    "arrays": set(),
    "text": set(),
    "limits": set(),
    "files": set(),
    "errors": {"text"},
    "losses": set(),
    "compiled": set(),
    "toml_text": {"limits"},
    "configuration": {"errors", "files", "limits", "toml_text"},
    "npz": {"limits"},
    "outputs": {"errors", "files"},
    "units": set(),
}
"""What every layer may use, and which of each other these modules use themselves."""
FILES_AND_GL = {"cv2", "moderngl", "mcap", "mcap_protobuf", "foxglove_schemas_protobuf", "pathlib", "os"}
HEAVY = {"numpy", "scipy", "cv2", "pydantic", "mcap", "moderngl", "google.protobuf"}
MODULES = sorted(PACKAGE.rglob("*.py"))


def imported(node: ast.AST) -> list[str]:
    """Full names of what one import statement loads, with what it takes from a module."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        assert node.level == 0, "imports are absolute"
        return [f"{node.module}.{alias.name}" for alias in node.names]
    return []


def imports(path: Path) -> list[str]:
    """Everything that a module imports, also inside its functions."""
    return [name for node in ast.walk(ast.parse(path.read_text())) for name in imported(node)]


def module_level_imports(path: Path) -> list[str]:
    return [name for node in ast.parse(path.read_text()).body for name in imported(node)]


def part_of(name: str) -> str:
    """The layer, or the module below all layers, that a name of ours is in; '' for the package itself."""
    part = f"{name}.".split(".")[1]
    return part if part in LAYERS or part in BELOW_ALL else ""


def ours(names: list[str]) -> set[str]:
    return {part_of(name) for name in names if name.split(".")[0] == PACKAGE.name}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_each_layer_imports_only_from_those_below(path: Path) -> None:
    layer = path.relative_to(PACKAGE).parts[0].removesuffix(".py").removesuffix("__init__")
    used = ours(imports(path))
    if layer in BELOW_ALL:
        assert used <= BELOW_ALL[layer]
    else:
        assert used <= {*BELOW_ALL, *LAYERS[LAYERS.index(layer) :]} - {APART.get(layer)}


def test_every_folder_is_a_layer() -> None:
    folders = {path.name for path in PACKAGE.iterdir() if path.is_dir() and any(path.glob("*.py"))}
    assert folders == set(LAYERS)


@pytest.mark.parametrize("path", sorted((PACKAGE / "filtering").glob("*.py")), ids=lambda path: path.name)
def test_filters_know_arrays_only(path: Path) -> None:
    names = imports(path)
    assert ours(names) <= {"", "arrays", "errors", "filtering"}
    assert not {name.split(".")[0] for name in names} & FILES_AND_GL


@pytest.mark.parametrize("path", sorted((PACKAGE / "cli").glob("*.py")), ids=lambda path: path.name)
def test_commands_import_what_is_heavy_inside(path: Path) -> None:
    assert ours(module_level_imports(path)) <= {"", "errors", "text", "cli"}


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["hand", "run", "--help"]], ids=" ".join)
def test_help_loads_nothing_heavy(arguments: list[str]) -> None:
    code = (
        "import sys; from posetrack_cli.cli.main import run; "
        f"code = run({arguments!r}); "
        f"print('LOADED', sorted({HEAVY!r} & set(sys.modules))); sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "LOADED []"
