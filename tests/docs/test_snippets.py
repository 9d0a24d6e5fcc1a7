"""What README and the page Start say is typed here, in a folder with ``face.mp4`` and ``depth.mcap``."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results import load_arrays
from support.markdown import PAGES, ROOT, Block, blocks, statements

README, START = ROOT / "README.md", ROOT / "docs" / "index.md"
FRAMES = 36
"""Of each recording."""
NOT_RUN = {
    ("README.md", "installs packages"): 1,
    ("docs/index.md", "installs packages"): 1,
    ("docs/index.md", "prepares a checkout"): 1,
    ("docs/other-tools.md", "installs packages"): 1,
    ("docs/other-tools.md", "programs of ROS 2"): 1,
}
"""Blocks that are marked as not run, by page and reason: whoever marks another one, tells it here."""


@dataclass
class Place:
    """A folder in which snippets are typed one after the other, and what was typed already."""

    folder: Path
    typed: set[str] = field(default_factory=set)

    def type(self, block: Block) -> None:
        """Run a block; a line that was run before stays done, as results are not replaced."""
        if block.language == "python":
            self._run([sys.executable, "-c", block.text], block)
            return
        lines = [line for line in map(_plain, statements(block.text)) if line not in self.typed]
        self.typed.update(lines)
        self._run(["bash", "-euo", "pipefail", "-c", "\n".join(lines)], block)

    def _run(self, command: list[str], block: Block) -> None:
        paths = f"{self.folder / 'bin'}{os.pathsep}{os.environ['PATH']}"
        ran = subprocess.run(
            command,
            cwd=self.folder,
            env=os.environ | {"PATH": paths, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
        )
        assert ran.returncode == 0, f"{block.place}: exit code {ran.returncode}\n{ran.stdout}{ran.stderr}"


def _plain(line: str) -> str:
    """A line without the comment behind it."""
    return line.split("  #", 1)[0].rstrip()


def write_face(path: Path, folder: Path) -> None:
    """A video of a synthetic head."""
    made = [
        "--camera-count",
        "1",
        "--frames",
        str(FRAMES),
        "--motion",
        "slight",
        "--light",
        "steady",
        "--seed",
        "1",
    ]
    assert run(["head", "synth", *made, "-o", str(folder)]) == 0
    writer = None
    for frame in open_recording(folder, "grey").frames():
        image = cv2.cvtColor(np.asarray(frame.images[0], dtype=np.uint8), cv2.COLOR_GRAY2BGR)
        if writer is None:
            size = (image.shape[1], image.shape[0])
            writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"mp4v"), 30.0, size)
        writer.write(image)
    assert writer is not None
    writer.release()


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    folder = tmp_path_factory.mktemp("newcomer")
    command = folder / "bin" / "posetrack"
    command.parent.mkdir()
    command.write_text(
        f'#!/bin/sh\nexec "{sys.executable}" -m posetrack_cli.cli.main "$@"\n', encoding="utf-8"
    )
    command.chmod(0o755)
    write_face(folder / "face.mp4", tmp_path_factory.mktemp("head") / "images")
    depth = ["--frames", str(FRAMES), "--seed", "1", "-o", str(folder / "depth.mcap")]
    assert run(["hand", "synth", *depth]) == 0
    return Place(folder)


def runnable(path: Path) -> list[Block]:
    return [block for block in blocks(path) if block.language in ("bash", "python") and block.reason is None]


def test_nothing_else_is_left_out() -> None:
    marked = Counter((block.page, block.reason) for path in PAGES for block in blocks(path) if block.reason)
    assert marked == NOT_RUN


def test_recipes_of_the_readme_work(place: Place) -> None:
    typed = runnable(README)
    assert len(typed) == 3  # a face video, a depth recording, a gate
    for block in typed:
        place.type(block)
    for name in ("face", "hand"):
        result = load_arrays(place.folder / f"{name}.mcap")
        assert np.mean(result["status"] == "tracking") > 0.9
        assert (
            (place.folder / f"{name}.html").read_text(encoding="utf-8").lower().startswith("<!doctype html>")
        )
        drawn = cv2.VideoCapture(str(place.folder / f"{name}-tracked.mp4"))
        assert int(drawn.get(cv2.CAP_PROP_FRAME_COUNT)) == len(result["position"])
        drawn.release()
    # The gate's exit code means something: asked for the impossible it is 1.
    assert run(["eval", str(place.folder / "hand.mcap"), "--fail-if", "joint_error_mm.mean > 0"]) == 1


def test_the_page_start_works(place: Place) -> None:
    for block in runnable(START):
        place.type(block)
    assert (place.folder / "hand.csv").stat().st_size > 0
    assert (place.folder / "made-head" / "camera.toml").is_file()
