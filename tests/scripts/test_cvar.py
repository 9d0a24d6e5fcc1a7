"""The conversion of annotated, head-mounted recordings: joints, missing readings, crop."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.errors import RecordingError
from posetrack_cli.evaluation.reading.truth_topics import points_track
from posetrack_cli.hand.model.anatomy import ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results.estimate import Subject
from research import cvar
from support.cvar import make_folder

HAND = Subject("hand", "camera", ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS)
FILE_DIGITS = 5e-4
"""The annotation has three decimals."""
REAL = 80
"""Real frames that are looked at, of some three hundred."""


@pytest.mark.parametrize("width", [320, 321])
def test_depth_and_joints_come_through(tmp_path: Path, width: int) -> None:
    out = cvar.convert(make_folder(tmp_path / "P9", width=width), tmp_path / "P9.mcap")
    recording = open_recording(out)
    frames = list(recording.frames())
    assert [frame.stamp_ns for frame in frames] == [0, 33_333_333, 66_666_667]
    for index, frame in enumerate(frames):
        assert frame.depth.shape == (240, 320)
        assert frame.depth[0, 0] == 0.0
        assert (frame.depth.ravel()[1:] == 600.0 + index).all()
    assert (recording.cameras[0].fx, recording.cameras[0].cy) == (224.5, 120.0)
    truth = points_track(McapFile(out), HAND, "truth")
    assert truth.stamp_ns.tolist() == [frame.stamp_ns for frame in frames]
    at = dict(zip(truth.point_names, truth.points[0], strict=True))
    assert at["wrist"] == pytest.approx(((100 - 160) * 500 / 224.5, (50 - 120) * 500 / 230.5, 500))
    # the file's joint 17 is the thumb's first, its joint 8 the middle finger's tip
    assert at["thumb_cmc"] == pytest.approx(((117 - 160) * 517 / 224.5, (84 - 120) * 517 / 230.5, 517))
    assert at["middle_tip"] == pytest.approx(((108 - 160) * 508 / 224.5, (66 - 120) * 508 / 230.5, 508))


def test_damaged_annotations_are_named(tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "P9")
    text = (folder / "joint.txt").read_text()
    (folder / "joint.txt").write_text(text.replace("520.000 \n", "\n", 1))
    message = r"joint.txt:2: unexpected number of joints, found 62, expected 63"
    with pytest.raises(RecordingError, match=message):
        cvar.convert(folder, tmp_path / "P9.mcap")
    (folder / "joint.txt").write_text(text.replace("3\n", "4\n", 1))
    with pytest.raises(RecordingError, match="wrong number of frames, found 3, expected 4"):
        cvar.convert(folder, tmp_path / "P9.mcap")
    with pytest.raises(RecordingError, match="no images"):
        cvar.convert(tmp_path, tmp_path / "P9.mcap")


def test_real_joints_lie_on_the_hand(tmp_path: Path, measured_data: Path) -> None:
    """Behind the visible surface by 0 to 40 mm at most joints: so units, axes and order are right."""
    source, part = measured_data / "cvar-hand" / "P1", tmp_path / "P1"
    part.mkdir()
    for path in sorted(source.glob("*_depth.png"))[:REAL]:
        shutil.copy(path, part)
    rows = (source / "joint.txt").read_text().splitlines(keepends=True)
    (part / "joint.txt").write_text("".join([f"{REAL}\n", *rows[1 : REAL + 1]]))
    out = cvar.convert(part, tmp_path / "P1.mcap")
    recording, truth = open_recording(out), points_track(McapFile(out), HAND, "truth")
    camera, behind = recording.cameras[0], []
    assert truth.points is not None
    for points, frame in zip(truth.points, recording.frames(), strict=True):
        x, y, z = points.T
        u = np.clip(np.rint(camera.fx * x / z + camera.cx).astype(int), 0, camera.width - 1)
        v = np.clip(np.rint(camera.fy * y / z + camera.cy).astype(int), 0, camera.height - 1)
        surface = frame.depth[v, u]
        behind.append((z - surface)[surface > 0])
    distances = np.concatenate(behind)
    assert ((distances > 0.0) & (distances < 40.0)).mean() > 0.6
    assert 5.0 < np.median(distances) < 20.0
