"""A hand's BVH, read by a small reader of its own: every joint is where the result says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DONE, EXIT_FAILED, ResultError
from posetrack_cli.hand.bvh import bvh_text
from posetrack_cli.hand.model.anatomy import JOINT_NAMES, JOINT_PARENTS, make_anatomy
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.results import ResultWriter, load_arrays, read_result
from posetrack_cli.results.export.source import export_source
from support.hand_results import FRAMES, STEP_NS, SUBJECT, hand, poses, thumbs, write
from support.results import CAMERA

ROUNDING_MM = 2e-3
"""Six digits of metres: 1e-3 mm; of degrees along 200 mm: 2e-5; rotations in single precision: 4e-5."""


def read_bvh(text: str) -> tuple[float, dict[str, np.ndarray]]:
    """Frame time, and where the joints are (F, 3); ends are called as what they end, with ``end``."""
    head, motion = text.split("MOTION\n")
    count, step, *rows = motion.splitlines()
    values = np.array([[float(value) for value in row.split()] for row in rows])
    assert int(count.removeprefix("Frames: ")) == len(values)
    joints: list[tuple[str, int, np.ndarray, list[str]]] = []
    stack: list[int] = []
    names = re.findall(r"(ROOT|JOINT|End|OFFSET|CHANNELS|})([^{}\n]*)", head)
    for word, rest in names:
        if word in ("ROOT", "JOINT", "End"):
            name = rest.strip() if word != "End" else f"{joints[stack[-1]][0]} end"
            joints.append((name, stack[-1] if stack else -1, np.zeros(3), []))
            stack.append(len(joints) - 1)
        elif word == "OFFSET":
            joints[-1][2][:] = [float(value) for value in rest.split()]
        elif word == "CHANNELS":
            joints[-1][3].extend(rest.split()[1:])
        else:
            stack.pop()
    placed: list[np.ndarray] = []
    turned: list[Rotation] = []
    column = 0
    for _, parent, offset, channels in joints:
        own = values[:, column : column + len(channels)]
        column += len(channels)
        shift = np.tile(offset, (len(values), 1))
        local = Rotation.identity(len(values))
        for channel, value in zip(channels, own.T, strict=True):
            if channel.endswith("position"):
                shift[:, "XYZ".index(channel[0])] += value
            else:
                local = local * Rotation.from_euler(channel[0], value[:, None], degrees=True)
        placed.append(shift if parent < 0 else placed[parent] + turned[parent].apply(shift))
        turned.append(local if parent < 0 else turned[parent] * local)
    assert column == values.shape[1]
    return float(step.removeprefix("Frame Time: ")), {
        name: place for (name, *_), place in zip(joints, placed, strict=True)
    }


def in_camera_mm(found: dict[str, np.ndarray]) -> np.ndarray:
    """(F, 21, 3) in our order and axes."""
    ends = {
        name: f"{JOINT_NAMES[JOINT_PARENTS[k]]} end" for k, name in enumerate(JOINT_NAMES) if "tip" in name
    }
    return np.stack([found[ends.get(name, name)] for name in JOINT_NAMES], axis=1) * [1e3, -1e3, -1e3]


@pytest.mark.parametrize("inner", [False, True])
@pytest.mark.parametrize("side", ["right", "left"])
def test_every_joint_is_where_the_result_says(tmp_path: Path, side: str, inner: bool) -> None:
    path, out = write(tmp_path / "r.mcap", hand(side), inner=inner), tmp_path / "r.bvh"
    assert run(["export", str(path), "-o", str(out)]) == EXIT_DONE
    step, found = read_bvh(out.read_text())
    assert step == pytest.approx(STEP_NS * 1e-9, abs=1e-9)
    np.testing.assert_allclose(in_camera_mm(found), load_arrays(path)["points"], rtol=0, atol=ROUNDING_MM)


def test_the_skeleton_is_a_flat_hand_with_its_fingers_up(tmp_path: Path) -> None:
    source = export_source(read_result(write(tmp_path / "r.mcap", hand("right"))))
    text = "".join(bvh_text(source, hand("right"))[1])
    rest = re.sub(r"(?<=Time: 0.033333333\n)[\s\S]*", " ".join(["0"] * 51) + "\n", text).replace(
        f"Frames: {FRAMES}", "Frames: 1"
    )
    found = read_bvh(rest)[1]
    for finger in ("index", "middle", "ring", "little"):
        assert found[f"{finger}_dip end"][0, 1] > found[f"{finger}_mcp"][0, 1] > found["wrist"][0, 1] == 0.0
    assert found["index_mcp"][0, 0] > found["little_mcp"][0, 0], "seen from its palm, a right thumb is right"


def test_angles_go_on_from_frame_to_frame(tmp_path: Path) -> None:
    """An editor draws what lies between frames: no jump by a turn, though the hand turns around."""
    source = export_source(read_result(write(tmp_path / "r.mcap", hand("right"))))
    rows = "".join(bvh_text(source, hand("right"))[1]).split("Frame Time: ")[1].splitlines()[1:]
    angles = np.array([[float(value) for value in row.split()[6:]] for row in rows])
    assert np.abs(np.diff(angles, axis=0)).max() < 30.0


def test_dropped_frames_lie_between_their_neighbours(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    anatomy, gap = hand("right"), range(10, 14)
    path, out = write(tmp_path / "r.mcap", anatomy, gap, inner=True), tmp_path / "r.bvh"
    assert run(["export", str(path), "-o", str(out)]) == EXIT_DONE
    assert "4 of 40 frames at 30 Hz have no estimate: they lie between" in capfd.readouterr().err
    found, before, after = in_camera_mm(read_bvh(out.read_text())[1]), gap.start - 1, gap.stop
    ends = poses(anatomy)[[before, after]]
    turns = Slerp([before, after], Rotation.from_quat(ends[:, 3:7]))(gap).as_quat()
    share = (np.array(gap) - before)[:, None] / (after - before)
    between = ends[0] + share * (ends[1] - ends[0])
    between[:, 3:7] = turns
    of_ends = thumbs()[[before, after]]
    thumb = of_ends[0] + share * (of_ends[1] - of_ends[0])
    np.testing.assert_allclose(found[gap], joint_positions(anatomy, between, thumb), atol=ROUNDING_MM)
    kept = [index for index in range(FRAMES) if index not in gap]
    np.testing.assert_allclose(found[kept], load_arrays(path)["points"], atol=ROUNDING_MM)


def test_a_track_of_another_hand_is_refused(tmp_path: Path) -> None:
    source = export_source(read_result(write(tmp_path / "r.mcap", hand("right"))))
    with pytest.raises(ResultError, match=r"is of another hand, found joints off by [\d.]+ mm"):
        bvh_text(source, make_anatomy())


def test_a_result_that_tells_no_hand_is_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with ResultWriter(tmp_path / "r.mcap", SUBJECT, CAMERA, {"configuration": "{}"}) as writer:
        writer.finish({})
    assert run(["export", str(tmp_path / "r.mcap"), "--format", "bvh"]) == EXIT_FAILED
    assert "run record has no hand configuration" in capfd.readouterr().err
