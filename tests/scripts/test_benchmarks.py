"""scripts/bench: its rows, clocks, recordings, processes; no test looks at how long anything takes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from benchmarking.__main__ import main
from benchmarking.processes import usage_of
from benchmarking.recordings import link_recording
from benchmarking.rows import median_of_pairs
from benchmarking.stepping import in_turn
from posetrack_cli.recording.camera_file import camera_file_text
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.synthesis.head.frames import make_cameras
from posetrack_cli.synthesis.head.options import HeadSynthOptions


def test_a_ratio_is_of_pairs_and_not_of_medians() -> None:
    """A clock that slows down threefold halfway changes no pair."""
    assert median_of_pairs([2.0, 2.0, 6.0], [1.0, 1.0, 3.0]) == 2.0
    assert median_of_pairs([4.0, 1.0, 9.0], [2.0, 1.0, 1.0]) == 2.0  # of the medians: 4


class Pacer:
    """A walker that says when it was called."""

    def __init__(self, calls: list[str], name: str) -> None:
        self.calls, self.name = calls, name

    def step(self, index: int, shown: Any) -> float:
        self.calls.append(f"{self.name}{index}{shown}")
        return float(index)


def test_walkers_take_turns_in_both_orders() -> None:
    calls: list[str] = []
    times = in_turn({name: Pacer(calls, name) for name in "pq"}, ["x", "y", "z"], warm_up=1)
    assert calls == ["q0x", "p0x", "p1y", "q1y", "q2z", "p2z"]
    assert times == {"p": [1.0, 2.0], "q": [1.0, 2.0]}


def test_a_long_recording_of_a_head_shows_both_cameras_to_and_fro(tmp_path: Path) -> None:
    cameras = make_cameras(HeadSynthOptions(frames=3))
    seen = tmp_path / "seen"
    seen.mkdir()
    (seen / "camera.toml").write_text(camera_file_text(cameras, []))
    for camera, offset in zip(cameras, (0, 100), strict=True):
        (seen / camera.name).mkdir()
        for k in range(3):
            image = np.full((camera.height, camera.width), offset + 10 * k, np.uint8)
            cv2.imwrite(str(seen / camera.name / f"{k:06d}.png"), image)
    link_recording(tmp_path / "long", seen, 7)
    frames = list(open_recording(tmp_path / "long", "grey", fps=30.0).frames())
    shown = [[int(image[0, 0]) for image in frame.images if image is not None] for frame in frames]
    assert shown == [[10 * k, 100 + 10 * k] for k in (0, 1, 2, 1, 0, 1, 2)]


def test_a_process_is_measured_by_itself() -> None:
    """100 MiB more are seen as such, however large this process is."""
    few, many = (usage_of([sys.executable, "-S", "-c", f"b'x' * ({mib} << 20)"])[1] for mib in (10, 110))
    assert many - few == pytest.approx(100.0, abs=5.0)  # the interpreter's own pages
    with pytest.raises(subprocess.CalledProcessError):
        usage_of([sys.executable, "-S", "-c", "raise SystemExit(3)"])


def test_a_part_by_itself_is_printed_and_written(tmp_path: Path) -> None:
    """The command from end to end, of its shortest part."""
    out = tmp_path / "new" / "bench.json"
    result = CliRunner().invoke(main, ["--quick", "--part", "commands", "--json", str(out)])
    assert result.exit_code == 0, result.output
    written = json.loads(out.read_text())
    assert written["source"]["length"] == "quick"
    names = [row["name"] for row in written["rows"]]
    commands_ = ("posetrack", "posetrack head stereo", "posetrack head mono")
    assert names == [f"{command} --help, CPU time" for command in commands_]
    assert all(
        row["value"] > 0.0 and name in result.output for row, name in zip(written["rows"], names, strict=True)
    )
