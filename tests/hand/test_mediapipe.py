"""JSON like MediaPipe's, read by our reader of keypoints and against its definitions."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DONE
from posetrack_cli.hand.keypoints.file import read_keypoints
from posetrack_cli.results import Result, read_result
from support.hand_results import FRAMES, hand, write
from support.results import CAMERA

LOST = (3, 8)
ROUNDING = 1e-9


@pytest.fixture(scope="module", params=["right", "left"])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    folder = tmp_path_factory.mktemp(request.param)
    path, out = write(folder / "r.mcap", hand(request.param), lost=LOST), folder / "r.json"
    assert run(["export", str(path), "--format", "mediapipe", "-o", str(out)]) == EXIT_DONE
    return read_result(path), out


def test_our_reader_takes_it_for_keypoints_in_the_image(made: tuple[Result, Path]) -> None:
    result, out = made
    keypoints = read_keypoints(out, CAMERA)
    pixels = result.to_numpy()["pixels"][:, 0]
    tracked = [k for k in range(FRAMES) if k not in LOST]
    assert len(keypoints.sets) == len(tracked)
    np.testing.assert_allclose(keypoints.sets.points[..., :2], pixels[tracked], rtol=0, atol=ROUNDING)
    # Below 0.5 a score says nothing of the side.
    score = np.maximum(result.to_numpy()["confidence"][tracked], 0.5)
    expected = score if hand_side(out) == "Right" else 1.0 - score
    np.testing.assert_allclose(keypoints.sets.right, expected, rtol=0, atol=ROUNDING)


def test_landmarks_follow_the_definitions(made: tuple[Result, Path]) -> None:
    result, out = made
    arrays, frames = result.to_numpy(), json.loads(out.read_text())
    assert [frame["frame"] for frame in frames] == list(range(FRAMES))
    for k, frame in enumerate(frames):
        if k in LOST:
            assert frame["handedness"] == frame["handLandmarks"] == frame["handWorldLandmarks"] == []
            continue
        (image,), (world,) = (
            [np.array([[p[axis] for axis in "xyz"] for p in one]) for one in frame[name]]
            for name in ("handLandmarks", "handWorldLandmarks")
        )
        points, u, v = arrays["points"][k], *arrays["pixels"][k, 0].T
        # Pixel centres are whole numbers in OpenCV, and n + 1/2 of an image that begins at 0.
        np.testing.assert_allclose(image[:, 0], (u + 0.5) / CAMERA.width, rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(image[:, 1], (v + 0.5) / CAMERA.height, rtol=0, atol=ROUNDING)
        # z is relative to the wrist, and as wide as x is for a hand as far away as the wrist.
        depth = points[:, 2] - points[0, 2]
        np.testing.assert_allclose(
            image[:, 2], depth / points[0, 2] * CAMERA.fx / CAMERA.width, atol=ROUNDING
        )
        np.testing.assert_allclose(world.mean(axis=0), 0.0, atol=ROUNDING)
        np.testing.assert_allclose(world - world[0], 1e-3 * (points - points[0]), rtol=0, atol=ROUNDING)
        ((category,),) = frame["handedness"]
        side = hand_side(out)
        assert (category["categoryName"], category["index"]) == (side, ["Left", "Right"].index(side))
        assert category["score"] == arrays["confidence"][k]


def hand_side(out: Path) -> str:
    return "Right" if out.parent.name.startswith("right") else "Left"
