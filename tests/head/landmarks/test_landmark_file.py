"""Files of a face's landmarks: all layouts give the same ten points; noise and wild points are told."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.detection.finders import FaceGuess
from posetrack_cli.head.detection.points import EYE_DISTANCE_MM, FacePoints
from posetrack_cli.head.face.points import FEATURES, POINT_COUNT, POINT_NAMES, HeadPose
from posetrack_cli.head.landmarks.faces import IBUG_68, MEDIAPIPE_478, LandmarkFile, Landmarks, read_landmarks
from posetrack_cli.recording.base import Frame

CAMERA = Camera(640, 480, 900.0, 900.0, 319.5, 239.5, name="left")
FRAMES, NOISE_PX = 60, 1.5
Write = Callable[[Path, FloatArray], Path]


def true_pixels() -> FloatArray:
    """(N, K, 2) of a head that moves and turns."""
    pixels = []
    for t in np.linspace(0.0, 2.0, FRAMES):
        turn = np.array([np.cos(0.1 * t), 0.0, np.sin(0.1 * t), 0.0])
        pose = HeadPose(np.array([40.0 * np.sin(t), 10.0 * t, 700.0]), turn)
        pixels.append(CAMERA.pixels_from_points(pose.points(FEATURES))[0])
    return np.array(pixels)


def text(value: float) -> str:
    return f"{value:.4f}"


def by_name(folder: Path, pixels: FloatArray) -> Path:
    rows = [
        f"{t},{name},{text(x)},{text(y)}"
        for t, frame in enumerate(pixels)
        for name, (x, y) in zip(POINT_NAMES, frame, strict=True)
    ]
    return _written(folder / "named.csv", "\n".join(["frame,point,x,y", *rows]))


def a_row_each(folder: Path, pixels: FloatArray) -> Path:
    header = ["frame", *(f"{name}_{axis}" for name in POINT_NAMES for axis in "xy")]
    rows = [",".join([str(t), *map(text, frame.ravel())]) for t, frame in enumerate(pixels)]
    return _written(folder / "wide.csv", "\n".join([",".join(header), *rows]))


def openface(folder: Path, pixels: FloatArray) -> Path:
    """As FeatureExtraction writes it: blanks before names, frames from 1, and points in space."""
    names = ["frame", "face_id", "timestamp", "confidence", "success", "gaze_0_x", "eye_lmk_x_0", "pose_Tx"]
    names += [f"{axis}_{k}" for axis in "xyXYZ" for k in range(68)] + ["p_scale", "p_0", "AU01_r"]
    rows = []
    for t, frame in enumerate(pixels):
        x, y = np.full(68, 3.0), np.full(68, 4.0)
        x[list(IBUG_68)], y[list(IBUG_68)] = frame.T + 0.0
        cells = [str(t + 1), "0", text(t / 30), "0.98", "1", "0.1", "5.0", "7.0"]
        rows.append([*cells, *map(text, [*x, *y, *np.full(204, 9.0)]), "1.0", "2.0", "0.3"])
    lost = [*rows[0][:4], "0", *rows[0][5:]]
    rows = [[str(len(pixels) + 1), *lost[1:]], *rows]
    lines = [", ".join(row) for row in [names, *rows]]
    return _written(folder / "openface.csv", "\n".join(lines))


def _meshes(pixels: FloatArray) -> list[list[dict[str, float]]]:
    meshes = []
    for frame in pixels:
        mesh = np.full((478, 2), 0.5)
        mesh[list(MEDIAPIPE_478)] = (frame + 0.5) / (CAMERA.width, CAMERA.height)
        meshes.append([{"x": float(x), "y": float(y), "z": -0.01} for x, y in mesh])
    return meshes


def mediapipe_solutions(folder: Path, pixels: FloatArray) -> Path:
    frames = [
        {"frame": t, "multi_face_landmarks": [{"landmark": mesh}]} for t, mesh in enumerate(_meshes(pixels))
    ]
    return _written(folder / "solutions.json", json.dumps(frames))


def mediapipe_tasks(folder: Path, pixels: FloatArray) -> Path:
    frames = ({"faceLandmarks": [mesh]} for mesh in _meshes(pixels))
    return _written(folder / "tasks.jsonl", "\n".join(map(json.dumps, frames)))


LAYOUTS: tuple[Write, ...] = (by_name, a_row_each, openface, mediapipe_solutions, mediapipe_tasks)


def _written(path: Path, content: str) -> Path:
    path.write_text(content + "\n")
    return path


@pytest.mark.parametrize("write", LAYOUTS)
def test_every_layout_gives_the_same_points(tmp_path: Path, write: Write) -> None:
    pixels = true_pixels()[:8]
    found = read_landmarks(write(tmp_path, pixels), CAMERA)
    np.testing.assert_array_equal(found.sets.keys, np.arange(8))
    np.testing.assert_allclose(found.sets.points[..., :2], pixels, atol=1e-3)
    assert found.outliers == 0
    assert found.unit == ("normalised" if "json" in found.name else "px")


def shaken(seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Pixels with noise and wild points, and which are wild (N, K)."""
    rng, pixels = np.random.default_rng(seed), true_pixels()
    pixels = pixels + rng.normal(0.0, NOISE_PX, pixels.shape)
    wild = rng.random(pixels.shape[:2]) < 0.05
    wild[20] = True  # another face, or none
    pixels[wild] += rng.choice([-1.0, 1.0], (wild.sum(), 2)) * rng.uniform(25.0, 60.0, (wild.sum(), 2))
    return pixels, wild


def read_shaken(folder: Path) -> tuple[LandmarkFile, FloatArray]:
    pixels, wild = shaken()
    return read_landmarks(by_name(folder, pixels), CAMERA), wild


def test_noise_is_estimated_and_wild_points_are_left_out(tmp_path: Path) -> None:
    """The median of some 40 independent deviations tells a standard deviation to 18 %, ten of them to 6 %."""
    found, wild = read_shaken(tmp_path)
    np.testing.assert_allclose(found.noise_px, NOISE_PX, rtol=3 * 0.18)
    assert float(np.mean(found.noise_px)) == pytest.approx(NOISE_PX, rel=3 * 0.06)
    assert 20 not in found.sets.keys
    kept = np.delete(wild, 20, axis=0)
    left_out = np.isnan(found.sets.points[..., 0])
    assert left_out[kept].mean() > 0.9
    assert left_out[~kept].mean() < 0.02
    assert "60 faces" not in found.line and f"{found.outliers} outliers ignored" in found.line


def frame(index: int) -> Frame:
    return Frame(index, index * 33_000_000, (np.zeros((480, 640), np.uint8),))


def test_a_point_that_is_not_told_is_where_a_face_has_it(tmp_path: Path) -> None:
    pixels = true_pixels()
    rows = by_name(tmp_path, pixels).read_text().splitlines()
    rows = [row for row in rows if not row.startswith("3,left_mouth_corner,")]
    told = Landmarks(read_landmarks(_written(tmp_path / "less.csv", "\n".join(rows)), CAMERA), CAMERA)
    (face,) = told.faces(frame(3))
    missing = POINT_NAMES.index("left_mouth_corner")
    assert face.responses[missing] == 0.0 and np.delete(face.responses, missing).all()
    np.testing.assert_allclose(face.pixels, pixels[3], atol=1.0)
    assert told.faces(frame(FRAMES)) == ()


def test_reduced_images_have_reduced_landmarks(tmp_path: Path) -> None:
    file = read_landmarks(by_name(tmp_path, true_pixels()), CAMERA)
    half = replace(CAMERA, width=320, height=240, fx=450.0, fy=450.0, cx=159.5, cy=119.5)
    (whole,), (reduced,) = (
        Landmarks(file, CAMERA).faces(frame(5)),
        Landmarks(file, half, 0.5).faces(frame(5)),
    )
    np.testing.assert_allclose(reduced.pixels + 0.5, 0.5 * (whole.pixels + 0.5), atol=1e-6)
    assert reduced.pixels_per_mm == pytest.approx(0.5 * whole.pixels_per_mm, rel=1e-3)


def test_three_points_elsewhere_make_a_track_doubtful_and_noise_does_not(tmp_path: Path) -> None:
    found, _ = read_shaken(tmp_path)
    told, pixels = Landmarks(found, CAMERA), true_pixels()
    faces = {t: told.faces(frame(t)) for t in range(FRAMES)}
    assert not any(told.has_slid(pixels[t], face[0]) for t, face in faces.items() if face)
    slid = pixels[7].copy()
    slid[:2] += 12.0
    assert not told.has_slid(slid, faces[7][0])
    slid[4] += 12.0
    assert told.has_slid(slid, faces[7][0])


ROW = ",".join(["0", *["5.0"] * 20])
WIDE = ",".join(["frame", *(f"{name}_{axis}" for name in POINT_NAMES for axis in "xy")])
HOSTILE = {
    "an empty file": ("l.csv", "", "is empty"),
    "no points": ("l.csv", "frame,a,b\n1,2,3\n", "no keypoint columns"),
    "51 points": (
        "l.csv",
        ",".join(["frame", *(f"{a}_{k}" for a in "xy" for k in range(51))]) + "\n",
        "unknown set of points, found point 50, expected 10, 68, 70, 468 or 478 points",
    ),
    "another name": (
        "l.csv",
        "frame,point,x,y\n0,left_ear,1,2\n",
        "line 2: unknown point, found 'left_ear'",
    ),
    "in space": ("l.csv", WIDE.replace("_x", "_x_mm").replace("_y", "_y_mm") + f"\n{ROW}\n", "found mm"),
    "far away": ("l.csv", f"{WIDE}\n{ROW.replace('5.0', '5e6')}\n", "unknown unit.*--landmarks-unit"),
    "too few in a list": (
        "l.json",
        json.dumps([{"faceLandmarks": [[[1, 2]] * 71]}]),
        "unexpected number of points, found 71, expected 10, 68, 70, 468 or 478",
    ),
    "faces that are none": ("l.json", json.dumps([{"faces": 7}]), "faces are not a list, found int"),
    "no JSON": ("l.json", "{", "is not valid JSON"),
    "a frame before the first": (
        "l.csv",
        ",".join(["frame", "success", *(f"{a}_{k}" for a in "xy" for k in range(68))])
        + "\n"
        + ",".join(["0", "1", *["5"] * 136]),
        "invalid frame number, found frame 0, expected frames from 1 on",
    ),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_what_cannot_be_meant_is_told(tmp_path: Path, case: str) -> None:
    name, content, expected = HOSTILE[case]
    (tmp_path / name).write_text(content)
    with pytest.raises(UsageError, match=expected) as told:
        read_landmarks(tmp_path / name, CAMERA)
    assert str(tmp_path / name) in str(told.value) and "\n" not in str(told.value)


def test_ten_points_are_ten() -> None:
    assert len(set(IBUG_68)) == len(set(MEDIAPIPE_478)) == POINT_COUNT


def test_a_track_begins_at_features_that_are_seen_near_its_landmarks(tmp_path: Path) -> None:
    landmarks = Landmarks(read_landmarks(by_name(tmp_path, true_pixels()), CAMERA), CAMERA)
    (told,) = landmarks.faces(frame(5))
    beside = np.zeros((POINT_COUNT, 2))
    eye_distance = EYE_DISTANCE_MM * told.pixels_per_mm
    beside[8], beside[3] = [0.0, 0.1 * eye_distance], [0.5 * eye_distance, 0.0]
    responses = np.where(np.arange(POINT_COUNT) == 5, 0.1, 0.9)
    beside[5] = 1.0  # what hardly looks like the point
    guess = FaceGuess(np.zeros(2), eye_distance, 0.0, 1.0)
    seen = FacePoints(told.pixels + beside, responses, told.pixels_per_mm, np.zeros(3), guess)
    beside[[3, 5]] = 0.0
    np.testing.assert_allclose(landmarks.start_pixels(seen, told), told.pixels + beside)
