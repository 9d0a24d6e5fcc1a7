"""Processes of our own import what this one does, and nothing of the folder that a user is in."""

from __future__ import annotations

import subprocess
from pathlib import Path

import posetrack_cli
from posetrack_cli.interpreter import module_command, module_environment


def test_a_module_in_the_current_folder_is_not_imported(tmp_path: Path) -> None:
    """Recordings of strangers may lie beside a file called as one of the libraries."""
    for name in ("mcap", "numpy", "json", "posetrack_cli"):
        (tmp_path / f"{name}.py").write_text("open('pwned', 'w').close()")
    command = module_command("posetrack_cli.cli.main", "--version")
    done = subprocess.run(
        command, cwd=tmp_path, env=module_environment(), capture_output=True, text=True, check=True
    )
    assert done.stdout.split()[0].startswith("posetrack")
    assert not (tmp_path / "pwned").exists()


def test_it_is_the_same_package(tmp_path: Path) -> None:
    (tmp_path / "where.py").write_text("import posetrack_cli\nprint(posetrack_cli.__file__)")
    environment = module_environment()
    environment["PYTHONPATH"] += f":{tmp_path}"
    done = subprocess.run(
        module_command("where"), cwd="/", env=environment, capture_output=True, text=True, check=True
    )
    assert Path(done.stdout.strip()) == Path(posetrack_cli.__file__)
