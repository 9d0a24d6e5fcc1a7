"""Where compiled code is kept: apart for each state of the kernels' sources, and never in others' hands."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from numba.core.event import trigger_event

from posetrack_cli import compiled
from posetrack_cli.build import source_digest
from posetrack_cli.compiled import KERNEL_SOURCES, announced, compiling_s, kernel, watched

PACKAGE = Path(__file__).parents[1] / "posetrack_cli"
SOURCES = sorted(path for pattern in KERNEL_SOURCES for path in PACKAGE.glob(pattern))
CALL = """
import numpy as np
from posetrack_cli.geometry.kernels import rotation_matrix
out = np.zeros((3, 3))
rotation_matrix(np.array([0.0, 0.0, 0.0, 1.0]), out)
print(np.array_equal(out, np.eye(3)), rotation_matrix.dispatcher.stats.cache_path)
"""


def taken_from_us(path: Path) -> list[tuple[str, str]]:
    """Modules of ours that a file imports from, relative to the package, and what it takes."""
    nodes = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)]
    ours = [node for node in nodes if (node.module or "").startswith(f"{PACKAGE.name}.")]
    return [(str(n.module).split(".", 1)[1].replace(".", "/"), a.name) for n in ours for a in n.names]


def test_all_that_compiled_code_is_made_of_is_in_the_digest() -> None:
    """Every file with kernels, and every file whose constants they use."""
    for path in PACKAGE.rglob("*.py"):
        taken = taken_from_us(path)
        if ("compiled", "kernel") in taken or ("compiled", "inlined") in taken:
            assert path in SOURCES
            constants = {module for module, name in taken if name.isupper()}
            assert {PACKAGE / f"{module}.py" for module in constants} <= set(SOURCES)


@pytest.mark.parametrize("changed", [str(path.relative_to(PACKAGE)) for path in SOURCES])
def test_a_change_of_any_source_is_kept_apart(changed: str, tmp_path: Path) -> None:
    for path in SOURCES:
        copy = tmp_path / path.relative_to(PACKAGE)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, copy)
    digest = source_digest.__wrapped__  # of files as they are now
    assert digest(KERNEL_SOURCES, tmp_path) == digest(KERNEL_SOURCES)
    with (tmp_path / changed).open("a") as file:
        file.write("# changed\n")
    assert digest(KERNEL_SOURCES, tmp_path) != digest(KERNEL_SOURCES)


def answer(code: str, **environment: str) -> str:
    """What a new process prints, without the variables that say where caches are, but for those given."""
    names = ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")
    kept = {name: value for name, value in os.environ.items() if name not in names}
    done = subprocess.run(
        [sys.executable, "-c", code], env={**kept, **environment}, capture_output=True, text=True, cwd="/"
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.fixture
def where(monkeypatch: pytest.MonkeyPatch) -> Callable[..., str | None]:
    """The folder that a process with these variables, and no other that says where caches are, takes."""

    def found(**environment: str) -> str | None:
        for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
            monkeypatch.delenv(name, raising=False)
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setattr(tempfile, "tempdir", None)  # Python asks the environment once
        return compiled.kernel_folder.__wrapped__()

    return found


def test_the_folder_is_the_users_choice_first(tmp_path: Path, where: Callable[..., str | None]) -> None:
    numba, xdg, home = (str(tmp_path / name) for name in ("numba", "xdg", "home"))
    digest = source_digest(KERNEL_SOURCES)
    assert where(NUMBA_CACHE_DIR=numba, XDG_CACHE_HOME=xdg) == f"{numba}/posetrack/{digest}"
    assert where(XDG_CACHE_HOME=xdg, HOME=home) == f"{xdg}/posetrack/{digest}"
    assert where(HOME=home) == f"{home}/.cache/posetrack/{digest}"


def test_a_chosen_folder_is_used_although_it_cannot_be_written(
    tmp_path: Path, where: Callable[..., str | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posetrack_cli.cache._is_writable", lambda folder: False)
    assert where(NUMBA_CACHE_DIR=str(tmp_path)) is None
    folder = tmp_path / "posetrack" / source_digest(KERNEL_SOURCES)
    folder.mkdir(parents=True)
    assert where(NUMBA_CACHE_DIR=str(tmp_path)) == str(folder)


def test_without_a_home_compiled_code_lies_in_a_temporary_folder_of_ones_own(
    tmp_path: Path, where: Callable[..., str | None]
) -> None:
    blocked = tmp_path / "file"
    blocked.touch()
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    own = temporary / f"posetrack-{os.getuid()}"
    environment = {"HOME": str(blocked), "TMPDIR": str(temporary)}
    assert where(**environment) == str(own / source_digest(KERNEL_SOURCES))
    assert own.stat().st_mode & 0o077 == 0
    right, path = answer(CALL, **environment).split()
    assert right == "True"
    assert path.startswith(str(own))
    assert list(Path(path).glob("*rotation_matrix*.nbc"))  # what was compiled is there for the next process


def test_a_folder_that_others_may_write_is_not_trusted(
    tmp_path: Path, where: Callable[..., str | None]
) -> None:
    own = tmp_path / f"posetrack-{os.getuid()}"
    own.mkdir()
    own.chmod(0o777)
    assert where(HOME="/dev/null", TMPDIR=str(tmp_path)) is None
    assert answer(CALL, HOME="/dev/null", TMPDIR=str(tmp_path)) == "True None"  # compiled, and kept nowhere
    assert list(own.iterdir()) == []


def test_without_any_folder_to_write_to_nothing_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> str:
        raise FileNotFoundError(2, "No usable temporary directory found")

    monkeypatch.setattr(tempfile, "gettempdir", none)
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/dev/null")
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null")
    assert compiled.kernel_folder.__wrapped__() is None


def test_numbas_settings_are_left_as_they_were() -> None:
    code = (
        "import numba.core.config as c; before = c.CACHE_DIR; import posetrack_cli.geometry.kernels; "
        "print(c.CACHE_DIR == before)"
    )
    assert answer(code) == "True"


SAID = """
import numpy as np
from posetrack_cli.compiled import announced
from posetrack_cli.geometry.kernels import matrix_product, rotation_matrix
out = np.zeros((3, 3))
rotation_matrix(np.zeros(4, np.float32), np.zeros((3, 3), np.float32))  # nobody has asked to be told
with announced(print):
    rotation_matrix(np.array([0.0, 0.0, 0.0, 1.0]), out)
    matrix_product(out, out, out.copy())
print("done")
"""


def test_compiling_is_announced_once_and_not_where_it_is_loaded(tmp_path: Path) -> None:
    cache = {"NUMBA_CACHE_DIR": str(tmp_path)}
    said = "compiling kernels: about 30 s of CPU time, cached for later runs"
    assert answer(SAID, **cache).splitlines() == [said, "done"]
    assert answer(SAID, **cache) == "done"


def test_where_nothing_can_be_kept_a_run_says_so(tmp_path: Path) -> None:
    (tmp_path / f"posetrack-{os.getuid()}").touch()
    said = answer(SAID, HOME="/dev/null", TMPDIR=str(tmp_path)).splitlines()
    told = "compiling kernels: about 30 s of CPU time, not cached: no writable cache folder"
    assert said == [told, "done"]


# Within this process: a kernel that is made once more is what the next process would make


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where kernels of the test are kept."""
    monkeypatch.setattr(compiled, "kernel_folder", lambda: str(tmp_path / "cache"))
    return tmp_path / "cache"


def doubled(number: float) -> float:
    return 2.0 * number


def compilations() -> int:
    """Make a kernel as a new process does, call it, and count what is compiled."""
    lines: list[str] = []
    with announced(lines.append):
        assert kernel(doubled)(1.5) == 3.0
    return len(lines)


def test_a_kernel_is_kept(folder: Path) -> None:
    assert [compilations() for _ in range(3)] == [1, 0, 0]


def test_a_constant_is_compiled_for_as_any_other_number(folder: Path) -> None:
    """Of counts and flags that callers state, too; numba would take each for a type."""
    power = kernel(lambda number, exponent, inverse: number ** (-exponent if inverse else exponent))
    called = kernel(lambda number: power(number, 2, False) + power(number, 3, inverse=True))
    assert called(2.0) == 4.0 + 0.125
    assert len(power.dispatcher.signatures) == 1  # type: ignore[attr-defined]


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", [b"", b"\x80", b"garbage\n"], ids=["empty", "cut", "garbage"])
def test_a_damaged_cache_is_made_anew(folder: Path, suffix: str, damage: bytes) -> None:
    """As after a power cut: it is no error, and not compiled once more in every run."""
    assert compilations() == 1
    (damaged,) = folder.rglob(f"*.{suffix}")
    damaged.write_bytes(damage)
    assert [compilations(), compilations()] == [1, 0]


def test_a_cache_that_can_only_be_read_is_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container image. Permissions do not stop root, under which tests run."""
    assert compilations() == 1

    def refuse(locator: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("numba.core.caching._CacheLocator.ensure_cache_path", refuse)
    assert compilations() == 0


def test_what_cannot_be_kept_is_no_error(folder: Path) -> None:
    """As on a disk that is full, or was taken away."""
    made = kernel(doubled)
    assert made.dispatcher.stats.cache_path.startswith(str(folder))  # type: ignore[attr-defined]
    shutil.rmtree(folder)
    folder.touch()
    assert made(1.5) == 3.0


def test_kernels_are_counted_and_their_time_is_added_up() -> None:
    """A kernel that is compiled within another one counts, too; its time does not count twice."""
    lines: list[str] = []
    counts: list[int] = []
    before_s = compiling_s()
    with announced(lines.append, counts.append), watched(lambda: None):
        time.sleep(0.5)
        began_s = time.perf_counter()
        with trigger_event("numba:compile"), trigger_event("numba:compile"):
            time.sleep(0.1)
        most_s = time.perf_counter() - began_s
    assert len(lines) == 1 and counts == [1, 2]
    assert 0.1 <= compiling_s() - before_s <= most_s


def test_compiling_is_watched_and_can_be_refused(folder: Path) -> None:
    seen: list[bool] = []

    def refuse() -> None:
        seen.append(is_compiling())
        raise KeyboardInterrupt

    with watched(refuse) as is_compiling:
        with pytest.raises(KeyboardInterrupt):
            kernel(doubled)(1.5)
        assert (seen, is_compiling()) == ([True], False)
    assert [compilations(), compilations()] == [1, 0]
    with watched(refuse):
        assert kernel(doubled)(1.5) == 3.0, "what is loaded is not compiled"
