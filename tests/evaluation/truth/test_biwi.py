"""Poses of the Biwi data as truth: each number, and the stamps that its images have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posetrack_cli.errors import TruthError
from posetrack_cli.evaluation.reading.truth import load_biwi_poses, load_truth
from posetrack_cli.results.reader import read_result
from support.truth import HEAD, estimates, write_result

ROUNDING = 1e-6
"""Files have seven digits or fewer; ours are written with ten."""


def write(folder: Path, numbers: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Write poses as the data have them; return rotations and centres."""
    folder.mkdir()
    rotations = Rotation.random(len(numbers), random_state=1).as_matrix()
    centres = np.random.default_rng(1).uniform(-200, 900, (len(numbers), 3))
    for number, rotation, centre in zip(numbers, rotations, centres, strict=True):
        rows = [" ".join(f"{v:.10f}" for v in row) + " " for row in rotation]
        text = "\n".join([*rows, "", " ".join(f"{v:.10f}" for v in centre)]) + " \n"
        (folder / f"frame_{number:05d}_pose.txt").write_text(text)
    return rotations, centres


def test_poses_have_the_stamps_of_their_images(tmp_path: Path) -> None:
    rotations, centres = write(tmp_path / "01", [3, 4, 6])
    track = load_biwi_poses(tmp_path / "01", {})
    assert track.stamp_ns.tolist() == [0, 33_333_333, 100_000_000], "one image was lost"
    assert track.position is not None and track.quaternion is not None
    np.testing.assert_allclose(track.position, centres, atol=ROUNDING)
    np.testing.assert_allclose(Rotation.from_quat(track.quaternion).as_matrix(), rotations, atol=ROUNDING)
    assert load_biwi_poses(tmp_path / "01", {"input.fps": "10"}).stamp_ns.tolist()[-1] == 300_000_000


def test_eval_takes_the_folder(tmp_path: Path) -> None:
    write(tmp_path / "01", [3, 4, 6])
    result = read_result(write_result(tmp_path / "r.mcap", HEAD, estimates(HEAD, 3)))
    truth = load_truth(result, tmp_path / "01")
    assert truth is not None and len(truth) == 3


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1 0 0", "3 numbers"),
        ("x", "not a file of numbers"),
        ("2 " * 12, "rotation"),
        ("nan " * 12, "not a pose"),
    ],
)
def test_poses_that_cannot_be_used(tmp_path: Path, text: str, says: str) -> None:
    write(tmp_path / "01", [3])
    (tmp_path / "01" / "frame_00003_pose.txt").write_text(text)
    with pytest.raises(TruthError, match=says) as caught:
        load_biwi_poses(tmp_path / "01", {})
    assert "frame_00003_pose.txt" in str(caught.value) and "\n" not in str(caught.value)
