"""Which posetrack a result is of: its version, its sources, its libraries, the processor."""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from posetrack_cli.build import PACKAGE, only_in, processor_features, source_digest

ROOT = PACKAGE.parent


def digest(package: Path) -> str:
    """Of the files as they are now."""
    return source_digest.__wrapped__(root=package)


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """The package of a small checkout, with a shipped configuration next to it."""
    package = tmp_path / "checkout" / "posetrack_cli"
    files = {
        "a.py": "x = 256",
        "gl/a.vert": "void main() {}",
        "a.npz": "PK",
        "../configs/hands/a.toml": "x = 1",
    }
    for name, text in files.items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(text)
    return package


def test_an_installed_package_has_the_digest_of_its_checkout(checkout: Path, tmp_path: Path) -> None:
    installed = tmp_path / "site-packages" / "posetrack_cli"
    shutil.copytree(checkout, installed)
    shutil.copytree(checkout.parent / "configs", installed / "configs")
    (installed / "__pycache__").mkdir()
    (installed / "__pycache__" / "a.pyc").write_bytes(b"compiled")
    assert digest(installed) == digest(checkout)


@pytest.mark.parametrize("name", ["a.py", "gl/a.vert", "a.npz", "../configs/hands/a.toml", "new.py"])
def test_any_change_gives_another_digest(checkout: Path, name: str) -> None:
    before = digest(checkout)
    with (checkout / name).open("a") as file:
        file.write(" ")
    assert digest(checkout) != before


def test_another_name_or_another_place_of_bytes_gives_another_digest(checkout: Path) -> None:
    before = digest(checkout)
    (checkout / "a.py").rename(checkout / "b.py")
    renamed = digest(checkout)
    (checkout / "b.py").write_text("x = 256PK")
    (checkout / "a.npz").write_text("")
    assert len({before, renamed, digest(checkout)}) == 3


def version_of(folder: Path) -> str:
    """What a package that is built in a folder is called."""
    line = [sys.executable, "-m", "hatchling", "version"]
    return subprocess.run(line, cwd=folder, capture_output=True, text=True, check=True).stdout.strip()


def test_the_version_comes_from_git_and_an_archive_without_it_has_one_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    assert version_of(tmp_path) == "0.1.dev0"
    git = ["git", "-c", "user.name=a", "-c", "user.email=a@example.org"]
    monkeypatch.delenv("GIT_DIR", raising=False)
    for words in (["init", "--quiet"], ["add", "."], ["commit", "--quiet", "--message", "first"]):
        subprocess.run([*git, *words], cwd=tmp_path, check=True)
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=tmp_path, capture_output=True, text=True).stdout
    without_tags = version_of(tmp_path)
    assert re.fullmatch(r"0\.1\.dev1\+g[0-9a-f]{7,}", without_tags)
    assert commit.startswith(without_tags.partition("+g")[2])
    subprocess.run([*git, "tag", "v3.2.1"], cwd=tmp_path, check=True)
    assert version_of(tmp_path) == "3.2.1"


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the variables name kinds of x86 processors")
def test_the_processor_is_what_libraries_make_of_it() -> None:
    """They can be told to compute as on an older processor; results then differ in their last digits."""
    code = "from posetrack_cli.build import processor_features; print(processor_features())"
    older = {"OPENBLAS_CORETYPE": "Prescott", "OPENCV_CPU_DISABLE": "SSE4.1,SSE4.2,AVX,FP16,AVX2,AVX512-SKX"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | older, capture_output=True, text=True, check=True
    )
    features = done.stdout.strip()
    assert "openblas Prescott" in features and features.endswith("OpenCV SSE+SSE2+SSE3")
    assert features != processor_features()


def test_lists_differ_by_what_only_one_has() -> None:
    assert only_in("numpy 2.4.6, scipy 1.17.1", "numpy 2.4.5, scipy 1.17.1") == "numpy 2.4.6"
    assert only_in("numpy 2.4.6", "numpy 2.4.6") == ""
