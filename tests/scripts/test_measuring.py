"""What studies measure of hands and heads, against made-up tracks whose errors are known."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.evaluation.measuring.pose_metrics import INSIDE_90
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.shape_fit import MEASURES
from posetrack_cli.head.face.points import MEAN_SHAPE, MOUTH, HeadPose
from posetrack_cli.head.subject import StereoDiagnostics, head_subject
from posetrack_cli.head.tracker.frame_tracker import NO_SIGNS
from posetrack_cli.recording.camera_file import camera_file_text, load_rig
from posetrack_cli.results import Estimate, ResultWriter, Status
from research import hand_strangers, heads_strangers, mono, stereo
from research.heads import Compared, cameras_of, compare, mono_figures
from support.heads import CAMERAS, FRAME_NS, heads_folder, pose

# Hands


def test_stated_measures_hold_the_truth_as_often_as_they_do() -> None:
    true, sd = np.tile(np.linspace(20.0, 80.0, 13), (20, 1)), np.full((20, 13), 2.0)
    errors = np.where(np.arange(20)[:, None] < 5, 1.01, 0.99) * INSIDE_90 * sd
    errors[:, ~hand_strangers.COUNTED] = 50.0  # lengths from the wrist do not count
    rows, inside, of_rig = hand_strangers.shape_figures(true + errors, sd, true, true + errors)
    assert (inside, of_rig) == (0.75, 1.0)
    assert rows["hand length"]["inside"] == 0.0 and rows["palm width"]["inside"] == 0.75
    text = "".join(f"# {name.replace('_', ' ')} {20.0 + k:.1f} +- 0.7\n" for k, name in enumerate(MEASURES))
    stated, deviations = hand_strangers.stated_measures(text)
    assert stated.tolist() == [20.0 + k for k in range(13)] and set(deviations) == {0.7}


# Heads

FRAMES, LOST, FACTOR = 130, 2, 1.05
TURN = rotations.exponential(np.array([0.1, -0.2, 0.05]))
SHIFT = np.array([3.0, -2.0, 5.0])


def estimate(index: int, at: HeadPose, shape: np.ndarray, status: Status = Status.TRACKING) -> Estimate:
    tangent, learned = np.zeros(6), StereoDiagnostics(np.zeros(0), 0.25 if index > 3 else np.nan)
    return Estimate(
        frame_index=index,
        stamp_ns=(index + 1) * FRAME_NS,
        status=status,
        confidence=0.0 if status is Status.LOST else 0.5,
        position=at.position,
        quaternion=at.quaternion,
        shape=np.zeros(0),
        pose_rate=np.zeros(7),
        twist=tangent,
        pose_variance=tangent,
        twist_variance=tangent,
        points=at.points(shape),
        effective_sample_size=None,
        resampled=False,
        numbers=np.concatenate([learned.numbers(0), NO_SIGNS]),
        milliseconds=4.0,
    )


def reference(index: int) -> Estimate:
    """The mouth's corners come forward by 4 mm in every second frame from 122 on."""
    shape = np.array(MEAN_SHAPE)
    if index >= 122 and index % 2 == 0:
        shape[MOUTH, 2] += 4.0
    return estimate(index, pose(index), shape)


def seen_by_one(index: int) -> Estimate:
    """The reference with another frame of the head, in a unit that is 5 % longer; lost in two frames."""
    true = pose(index)
    turned = rotations.canonical(rotations.multiply(true.quaternion, TURN))
    moved = HeadPose((true.position + true.rotation @ SHIFT) / FACTOR, turned)
    shape = (MEAN_SHAPE - SHIFT) @ rotations.matrices_from_quaternions(TURN) / FACTOR
    if index < LOST:
        return estimate(index, replace(moved, position=moved.position + 400.0), shape, Status.LOST)
    return estimate(index, moved, shape)


def still_mouth(index: int) -> Estimate:
    """The reference with a mouth that does not move, lost in two frames and 20 mm off in frame 5."""
    true, off = pose(index), 300.0 if index < LOST else 20.0 if index == 5 else 0.0
    at = replace(true, position=true.position + np.array([off, 0.0, 0.0]))
    return estimate(index, at, MEAN_SHAPE, Status.LOST if index < LOST else Status.TRACKING)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Results by name."""
    folder = tmp_path_factory.mktemp("results")
    made: dict[str, Callable[[int], Estimate]] = {
        "truth": reference,
        "one": seen_by_one,
        "still": still_mouth,
    }
    for name, of in made.items():
        write_result(folder / f"{name}.mcap", map(of, range(FRAMES)))
    return {name: folder / f"{name}.mcap" for name in made}


def write_result(path: Path, estimates: Iterable[Estimate]) -> None:
    with ResultWriter(path, head_subject("left", 0), CAMERAS[0], {}, others=CAMERAS[1:]) as writer:
        for one in estimates:
            writer.write(one)
        writer.finish({})


def test_a_rigid_offset_and_one_factor_are_removed_and_nothing_else(results: dict[str, Path]) -> None:
    pair = results["one"], results["truth"]
    scaled, measured, raw = (compare(*pair, align) for align in ("similarity", "rigid", "none"))
    followed = scaled.followed
    assert followed.tolist() == [False] * LOST + [True] * (FRAMES - LOST)
    np.testing.assert_allclose(scaled.pose[followed], 0.0, atol=1e-6)
    # z grows by 2 per frame; the constant offset takes what 5 % of the mean are, not what they vary by
    assert 0.5 < measured.pose[followed, 2].mean() < 0.05 * 0.5 * FRAMES
    np.testing.assert_allclose(measured.rotation_deg[followed], 0.0, atol=1e-6)
    angle = np.degrees(rotations.angle_between(TURN, np.array(rotations.IDENTITY)))
    np.testing.assert_allclose(raw.rotation_deg[followed], angle, atol=1e-6)
    figures = mono_figures(*pair)
    assert figures["factor"] == pytest.approx(FACTOR, rel=1e-6)
    assert figures["tracked"] == pytest.approx(1.0 - LOST / FRAMES) and figures["first"] == LOST
    # of a face that is 5 % too small: neither a turn nor an error in depth is one of its shape
    size = np.linalg.norm(MEAN_SHAPE - MEAN_SHAPE.mean(axis=0), axis=1)
    assert figures["points_mm"] == pytest.approx(0.05 * size.mean(), rel=0.3)
    assert mono_figures(None, results["truth"]) == {} == mono_figures(results["one"], Path("none"))


def test_stereo_figures_are_of_tracked_frames_and_tell_deforming_from_neutral_ones(
    results: dict[str, Path],
) -> None:
    one = stereo.course(results["still"], results["truth"])
    found = stereo.stereo_figures(one, None)
    assert (found["first"], found["wrong"], found["ms"]) == (LOST, 1.0, 4.0)
    assert np.flatnonzero(stereo.wrong(one)).tolist() == [0, 1, 5]
    assert found["deforming x_mm"] == pytest.approx(one.pose[[122, 124, 126, 128], 0].mean())
    assert found["still x_mm"] == pytest.approx(one.pose[[120, 121, 123, 125, 127, 129], 0].mean())
    # the corner's offset is a mean: of 128 frames 4 are 4 mm away
    assert found["mouth_mm"] == pytest.approx(4.0 - 4.0 * 4 / (FRAMES - LOST), abs=0.4)
    assert "still moving_mm" not in found and "recovery_s" not in found


def steady(one: Compared, believed: np.ndarray, off_mm: np.ndarray) -> Compared:
    """Forty frames, ten a second."""
    count = len(believed)
    return replace(
        one, seconds=0.1 * np.arange(count), believed=believed, position_mm=off_mm, rotation_deg=0.0 * off_mm
    )


def test_a_head_is_found_again_once_it_is_right_for_half_a_second(results: dict[str, Path]) -> None:
    one = compare(results["still"], results["truth"])
    has_it, off = np.ones(40, dtype=np.bool_), np.zeros(40)
    assert stereo.recovery_s(steady(one, has_it, off), 1.0) == 0.0
    lost = has_it.copy()
    lost[8:13] = False
    assert stereo.recovery_s(steady(one, lost, off), 1.0) == pytest.approx(0.3)
    off[15] = 11.0  # right in frames 13 and 14 only, then steadily from 16 on
    assert stereo.recovery_s(steady(one, lost, off), 1.0) == pytest.approx(0.6)
    off[16:] = 11.0
    assert stereo.recovery_s(steady(one, lost, off), 1.0) == np.inf


def test_what_a_detector_does_with_other_people_is_removed_and_nothing_of_ones_own() -> None:
    others = np.array([[[1.0, 0.0]], [[3.0, 0.0]], [[8.0, 3.0]]])
    lengths = [[np.hypot(4.5, 1.5)], [1.5 * np.sqrt(2.0)], [np.hypot(6.0, 3.0)]]
    np.testing.assert_allclose(heads_strangers.without_others(others), lengths)
    np.testing.assert_allclose(heads_strangers.without_others(others[2:]), [[np.hypot(8.0, 3.0)]])


def test_a_calibration_becomes_a_camera_file(tmp_path: Path) -> None:
    calibration = heads_folder(tmp_path, "p") / "p" / "calibration.json"
    turn, values = (
        [[0.96, 0.0, 0.28], [0.0, 1.0, 0.0], [-0.28, 0.0, 0.96]],
        json.loads(calibration.read_text()),
    )
    values["cameras"]["right"] |= {"R_from_left": turn, "t_from_left_mm": [-118.0, 0.0, 20.0]}
    calibration.write_text(json.dumps(values))
    (tmp_path / "camera.toml").write_text(camera_file_text(cameras_of(calibration)))
    rig = load_rig(tmp_path / "camera.toml")
    stored = rig.stored_cameras({"left": (64, 48), "right": (64, 48)})
    assert [(c.fx, c.fy, c.cx, c.cy) for c in stored] == [(90.0, 90.0, 31.0, 23.0)] * 2
    placed = np.column_stack([turn, [-118.0, 0.0, 20.0]])
    np.testing.assert_allclose(stored[1].camera_T_reference, placed, atol=1e-9)


def test_jitter_is_the_noise_on_steady_motion_and_flips_are_of_tracked_frames() -> None:
    frames, rng = 4000, np.random.default_rng(1)
    noise = rng.standard_normal((frames, 6)) * [*[0.1] * 3, *[0.2] * 3]
    turned = rotations.exponential(np.radians(noise[:, 3:]))
    fields: dict[str, Any] = {
        "stamp_ns": np.arange(frames) * FRAME_NS,
        "lost": np.zeros(frames, dtype=np.bool_),
        "position": np.outer(np.arange(frames), [0.5, -0.2, 1.0]) + noise[:, :3],
        "quaternion": rotations.canonical(rotations.multiply(turned, np.array([1.0, 0.0, 0.0, 0.0]))),
    }
    track = Track("t", "head", (), (), (), **fields)
    found = mono.clip_figures(track)
    # second differences of neighbours are correlated by -2/3 and 1/6: some 0.4 of them are independent
    tolerance = 4.0 / np.sqrt(2.0 * 0.4 * frames)
    jitter = [found[name] for name in ("x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg")]
    np.testing.assert_allclose(jitter, [*[0.1] * 3, *[0.2] * 3], rtol=tolerance)
    turn = rotations.exponential(np.radians([0.0, 25.0, 0.0]))
    quaternion, lost = fields["quaternion"].copy(), fields["lost"].copy()
    quaternion[10:20] = rotations.multiply(turn, quaternion[10:20])
    lost[[9, 20]] = True
    assert mono.clip_figures(replace(track, quaternion=quaternion))["flips"] == 2.0
    assert mono.clip_figures(replace(track, quaternion=quaternion, lost=lost))["flips"] == 0.0
