"""The lines that README prints to set a checkout up are typed as they stand there, in a copy of this one.

What takes long is made small by the copy's surroundings: recordings have three frames, mypy and pytest get
one file each. Packages are those of this environment, so nothing is downloaded.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from posetrack_cli.compiled import kernel_folder
from support.command_server import TIMEOUT_S, served_command
from support.markdown import ROOT, blocks, statements

ENVIRONMENT = Path(sys.prefix)
REASON = "prepares a checkout"
OF_SETUP = ("pyproject.toml", "requirements.txt", "requirements-dev.txt", "scripts/setup")
"""The files whose state says for ``scripts/setup`` whether an environment is up to date."""


def printed(page: str) -> list[str]:
    """The lines of a page that set a checkout up, without what they say of themselves."""
    (block,) = [block for block in blocks(ROOT / page) if block.reason == REASON]
    return [line.partition("#")[0].strip() for line in statements(block.text)]


def command(path: Path, *lines: str) -> None:
    path.unlink(missing_ok=True)
    path.write_text("\n".join(["#!/bin/sh", *lines, ""]), encoding="utf-8")
    path.chmod(0o755)


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A copy with the environment of this one, as ``scripts/setup`` left it."""
    state = hashlib.sha256(b"".join((ROOT / name).read_bytes() for name in OF_SETUP)).hexdigest()
    for name in (".stamp-run", ".stamp"):
        stamp = ENVIRONMENT / name
        if not stamp.is_file() or stamp.read_text(encoding="utf-8").strip() != state:
            pytest.skip("this environment is not what scripts/setup makes of this checkout")
    copy = tmp_path / "checkout"
    shutil.copytree(
        ROOT, copy, symlinks=True, ignore=shutil.ignore_patterns(".*", "__pycache__", "out", "shared")
    )
    (copy / ".venv" / "bin").mkdir(parents=True)
    for folder in (Path(), Path("bin")):
        for entry in (ENVIRONMENT / folder).iterdir():
            if entry.name != "bin":
                (copy / ".venv" / folder / entry.name).symlink_to(entry)
    command(copy / ".venv" / "bin" / "mypy", f"exec {ENVIRONMENT}/bin/mypy posetrack_cli/units.py")
    return copy


def test_both_pages_print_the_same_commands() -> None:
    assert printed("README.md") == printed("docs/index.md") == ["scripts/demo", "scripts/test"]


def test_the_commands_work_as_printed(checkout: Path, tmp_path: Path) -> None:
    variables = {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTEST", "PYTHON"))
    }
    variables["PYTEST_ADDOPTS"] = "tests/test_text.py"
    kernels = kernel_folder()
    assert kernels is not None
    marked = hashlib.sha256(str(checkout / "scripts").encode()).hexdigest()[:16]
    warm = Path(kernels) / f"warm-{marked}"  # kernels are compiled where these tests are typed, not here
    warm.touch()
    said = {}
    try:
        with served_command(tmp_path / "served"):
            command(
                checkout / ".venv" / "bin" / "posetrack",
                'case "$2" in synth) set -- "$@" --frames 3;; esac',
                f'exec {tmp_path / "served"} "$@"',
            )
            for line in printed("README.md"):
                ran = subprocess.run(
                    ["bash", "-c", line],
                    cwd=checkout,
                    env=variables,
                    capture_output=True,
                    text=True,
                    timeout=TIMEOUT_S,
                )
                assert ran.returncode == 0, f"{line}\n{ran.stdout}\n{ran.stderr}"
                said[line] = ran.stdout
    finally:
        warm.unlink()
    for name in ("recording.mcap", "result.mcap", "report.html", "frames.png"):
        assert (checkout / "out" / "demo" / name).stat().st_size > 0
    assert "out/demo/report.html" in said["scripts/demo"]
    assert "passed" in said["scripts/test"] and "no issues found in 1 source file" in said["scripts/test"]
