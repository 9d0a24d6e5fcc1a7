"""Annotated points in images as truth of a head: numbers of frames, pixels, distances, damaged files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import PosetrackError, TruthError, UsageError
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.measuring.evaluation import Evaluation, Statistics
from posetrack_cli.evaluation.reading import image_points
from posetrack_cli.evaluation.reading.image_points import load_image_points
from posetrack_cli.evaluation.reading.truth import load_truth
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.face.points import MEAN_SHAPE, POINT_NAMES
from posetrack_cli.results.estimate import Subject
from posetrack_cli.results.reader import read_result
from posetrack_cli.results.writer import ResultWriter
from support.truth import FRAME_NS, HAND, estimates, write_result

FRAMES = 6
K1, K2, P1, P2, K3 = 0.1, -0.05, 0.001, -0.002, 0.01
CAMERA = Camera(640, 480, 800.0, 810.0, 320.0, 238.0, distortion=(K1, K2, P1, P2, K3), name="camera")
FACE = Subject("head", "camera", (), POINT_NAMES, (-1,) * len(POINT_NAMES))
IBUG = {
    "right_eye_outer": 37,
    "right_eye_inner": 40,
    "left_eye_inner": 43,
    "left_eye_outer": 46,
    "right_mouth_corner": 49,
    "left_mouth_corner": 55,
    "right_nostril": 33,
    "left_nostril": 35,
    "right_brow_inner": 22,
    "left_brow_inner": 23,
}
"""Numbers of the points in the published figure of 68 points, from 1; right is the person's own."""
PX = 1e-5
"""Files have six decimals."""


def points(frame: int) -> FloatArray:
    """A mean face before the camera that moves to the right, mm."""
    return MEAN_SHAPE * [1.0, -1.0, -1.0] + [5.0 * frame, -10.0, 700.0 + frame]


def result_at(
    tmp_path: Path, frames: range = range(FRAMES), shift_ns: int = 0, run: dict[str, str] | None = None
) -> Path:
    path = tmp_path / "r.mcap"
    blank = estimates(FACE, FRAMES)
    with ResultWriter(path, FACE, CAMERA, {"tracker": "head", **(run or {})}) as writer:
        for k in frames:
            stamp = k * FRAME_NS + shift_ns
            writer.write(replace(blank[k], stamp_ns=stamp, points=points(k)))
        writer.finish({})
    return path


def projected(at: FloatArray) -> FloatArray:
    """Brown and Conrady's model, as OpenCV states it."""
    x, y = at[:, 0] / at[:, 2], at[:, 1] / at[:, 2]
    r2 = x * x + y * y
    radial = 1 + K1 * r2 + K2 * r2**2 + K3 * r2**3
    u = x * radial + 2 * P1 * x * y + P2 * (r2 + 2 * x * x)
    v = y * radial + P1 * (r2 + 2 * y * y) + 2 * P2 * x * y
    return np.stack([800.0 * u + 320.0, 810.0 * v + 238.0], axis=1)


def text_of(pixels: FloatArray, count: int = 68) -> str:
    rows = [(7.0 + k, 9.0) for k in range(count)]
    for name, (x, y) in zip(POINT_NAMES, pixels, strict=True):
        rows[IBUG[name] - 1] = (float(x), float(y))
    body = "\n".join(f"{x:.6f} {y:.6f}" for x, y in rows)
    return f"version: 1\nn_points:  {count}\n{{\n{body}\n}}\n"


def annotated(
    folder: Path, first: int = 1, shift: tuple[float, float] = (0.0, 0.0), frames: range = range(FRAMES)
) -> Path:
    """Files of frames, whose first pixel is 1, 1."""
    folder.mkdir(parents=True)
    for k in frames:
        text = text_of(projected(points(k)) + 1.0 + shift)
        (folder / f"{k + first:06d}.pts").write_text(text)
    return folder


def measured(path: Path, folder: Path) -> Evaluation:
    return evaluate(path, EvalOptions(truth=folder))


def figures(got: Evaluation, address: str) -> Statistics:
    value = got.metrics[address]
    assert isinstance(value, Statistics)
    return value


@pytest.mark.parametrize("first", [0, 1])
def test_the_projected_points_themselves_have_no_error(tmp_path: Path, first: int) -> None:
    folder = annotated(tmp_path / "annot", first)
    got = measured(result_at(tmp_path), folder)
    assert got.metrics["matched"] == FRAMES
    assert figures(got, "landmark_error_px").max < PX
    assert f"the ground truth has only image points: annot (00000{first}.pts is frame 0)" in got.notes


def test_one_pixel_is_one_pixel_and_a_share_of_the_distance_of_the_eyes(tmp_path: Path) -> None:
    folder = annotated(tmp_path / "annot", shift=(0.6, -0.8))
    got = measured(result_at(tmp_path), folder)
    for address in ("landmark_error_px", "landmark_error_px.left_nostril"):
        assert figures(got, address).mean == pytest.approx(1.0, abs=PX)
        assert figures(got, address).sd == pytest.approx(0.0, abs=PX)
    right, left = (POINT_NAMES.index(f"{side}_eye_outer") for side in ("right", "left"))
    eyes = [np.hypot(*(p[left] - p[right])) for p in (projected(points(k)) for k in range(FRAMES))]
    assert figures(got, "landmark_nme").mean == pytest.approx(np.mean(100.0 / np.array(eyes)), rel=1e-4)


def test_a_wrong_frame_is_seen(tmp_path: Path) -> None:
    """Numbers that are off by one are off by the motion of a frame, 5 mm or 5.7 pixels."""
    folder = annotated(tmp_path / "annot", first=2, frames=range(FRAMES - 1))
    got = measured(result_at(tmp_path), folder)
    assert figures(got, "landmark_error_px").mean == pytest.approx(800.0 * 5.0 / 700.0, rel=0.1)


def test_frames_are_matched_by_number_whatever_their_stamps(tmp_path: Path) -> None:
    """Of every second frame, beginning with the third; the folder of the video is given."""
    annotated(tmp_path / "001" / "annot")
    got = measured(result_at(tmp_path, range(2, FRAMES, 2), shift_ns=10**15), tmp_path / "001")
    assert (got.metrics["matched"], got.metrics["unmatched"], got.metrics["missed"]) == (2, 0, 0)
    assert got.metrics["truth_outside"] == 3
    assert figures(got, "landmark_error_px").max < PX


def test_an_annotated_frame_that_the_run_lost_is_missed(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    blank = estimates(FACE, FRAMES)
    with ResultWriter(path, FACE, CAMERA, {"tracker": "head"}) as writer:
        for k in (0, 1, 2, 4, 5):
            writer.write(replace(blank[k], points=points(k)))
        writer.finish({})
    got = measured(path, annotated(tmp_path / "annot"))
    assert (got.metrics["matched"], got.metrics["missed"]) == (5, 1)


def test_all_that_needs_a_truth_in_space_says_so(tmp_path: Path) -> None:
    path = result_at(tmp_path)
    got = measured(path, annotated(tmp_path / "annot"))
    for name in ("x_mm", "rotation_deg", "point_error_mm", "nees", "velocity_error_mm_s", "frames_wrong"):
        assert got.absent[name] == "the ground truth has only image points"
    (tmp_path / "other").mkdir()
    in_space = evaluate(path, EvalOptions(truth=result_at(tmp_path / "other")))
    assert in_space.absent["landmark_error_px"] == "the ground truth has no image points"


def test_points_behind_the_camera_have_no_image_error(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    blank = estimates(FACE, FRAMES)
    with ResultWriter(path, FACE, CAMERA, {"tracker": "head"}) as writer:
        for k in range(FRAMES):
            writer.write(replace(blank[k], points=points(k) - [0.0, 0.0, 2000.0 if k == 2 else 0.0]))
        writer.finish({})
    got = measured(path, annotated(tmp_path / "annot"))
    assert "landmark errors without 1 frames with points outside the field of view" in got.notes
    assert figures(got, "landmark_error_px").max < PX
    assert np.isnan(got.series["landmark_nme"]).tolist() == [k == 2 for k in range(FRAMES)]


def test_annotations_of_other_frames_are_told(tmp_path: Path) -> None:
    got = measured(result_at(tmp_path), annotated(tmp_path / "annot", first=100))
    reason = "no annotated frame has an estimate: annot (000100.pts is frame 99)"
    assert got.absent["landmark_error_px"] == reason


def test_options_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    folder = annotated(tmp_path / "annot")
    result = read_result(result_at(tmp_path))
    with pytest.raises(UsageError, match="omit --time-offset-s"):
        load_truth(result, folder, time_offset_s=1.0)
    with pytest.raises(UsageError, match="omit --align"):
        evaluate(result.path, EvalOptions(truth=folder, align="rigid"))
    (tmp_path / "mirrored").mkdir()
    mirrored = result_at(tmp_path / "mirrored", run={"input.mirror": "true"})
    with pytest.raises(UsageError, match="mirrored"):
        measured(mirrored, folder)
    hand = write_result(tmp_path / "h.mcap", HAND, estimates(HAND, 3))
    with pytest.raises(TruthError, match="not a file"):
        measured(hand, folder)


def test_annotations_of_larger_images_are_refused(tmp_path: Path) -> None:
    folder = annotated(tmp_path / "annot", shift=(640.0, 0.0))
    with pytest.raises(TruthError, match=r"points up to [0-9]+, [0-9]+, expected 640x480"):
        measured(result_at(tmp_path), folder)


GOOD = text_of(projected(points(0)) + 1.0)
DAMAGED: dict[str, tuple[Callable[[Path], object], str]] = {
    "cut": (lambda p: p.write_text(GOOD[:300]), "incomplete .pts file"),
    "empty": (lambda p: p.write_bytes(b""), "incomplete .pts file"),
    "binary": (lambda p: p.write_bytes(b"\xff\xfe{\x00}"), "not UTF-8"),
    "fewer": (lambda p: p.write_text(GOOD.replace("8.000000 9.000000\n", "", 1)), "found 67, expected"),
    "count": (lambda p: p.write_text(GOOD.replace("68", "66")), "found 68, expected 66"),
    "column": (lambda p: p.write_text(GOOD.replace("8.000000 9", "8 9 9")), "point 2: not a point"),
    "nan": (lambda p: p.write_text(GOOD.replace("8.000000", "nan")), "point 2: is not finite"),
    "word": (lambda p: p.write_text(GOOD.replace("8.000000", "x")), "point 2: is not a number"),
    "long": (lambda p: p.write_text(GOOD.replace("8.000000", "x" * 9999)), "not a number"),
    "eyes": (lambda p: p.write_text(text_of(np.full((10, 2), 50.0))), "outer eye corners coincide"),
    "unnamed": (lambda p: p.rename(p.with_name("x.pts")), "no frame number"),
    "number": (lambda p: p.rename(p.with_name("9" * 40 + ".pts")), "no frame number"),
    "twice": (lambda p: p.with_name("1.pts").write_text(GOOD), "two files have the same frame number"),
    "folder": (lambda p: (p.unlink(), p.mkdir()), "cannot be read"),
}


@pytest.mark.parametrize("fault", DAMAGED)
def test_damage_is_told_in_one_line(tmp_path: Path, fault: str) -> None:
    folder = annotated(tmp_path / "annot")
    damage, words = DAMAGED[fault]
    damage(folder / "000001.pts")
    with pytest.raises(PosetrackError, match=words) as told:
        load_image_points(folder, read_result(result_at(tmp_path)))
    assert "\n" not in str(told.value) and len(str(told.value)) < 400


def test_a_folder_without_files_or_with_too_many(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = read_result(result_at(tmp_path))
    (tmp_path / "none").mkdir()
    with pytest.raises(TruthError, match="not a folder of image points, found no file"):
        load_image_points(tmp_path / "none", result)
    folder = annotated(tmp_path / "annot")
    monkeypatch.setattr(image_points.limits, "KEYPOINT_SETS", FRAMES - 1)
    with pytest.raises(TruthError, match="more than 5 files"):
        load_image_points(folder, result)
