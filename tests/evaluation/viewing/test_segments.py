"""The picture of a segmentation: its colours are its labels, where the image has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.errors import ResultError
from posetrack_cli.evaluation.reading.recording_of import configuration_of
from posetrack_cli.evaluation.viewing.drawing import Shown
from posetrack_cli.evaluation.viewing.hand_drawing import LABEL_COLOURS, HandSegments
from posetrack_cli.evaluation.viewing.layers import ViewOptions
from posetrack_cli.evaluation.viewing.view import ResultView
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.observe.segmentation import Label
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results.reader import read_result
from support.viewing import KINECT, make_recording, make_result, truth_of

CAMERA = Camera(160, 120, 120.0, 120.0, 79.5, 59.5)
SEGMENTS = HandSegments(make_anatomy(), HandConfig(), CAMERA)
POSE = Shown(np.array([0.0, 30.0, 500.0]), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(15))


def painted(depth: np.ndarray, shown: Shown = POSE) -> np.ndarray:
    picture = np.zeros((120, 160, 3), dtype=np.uint8)
    SEGMENTS.paint(picture, depth, shown)
    return picture


def test_every_pixel_of_the_window_has_its_label_s_colour() -> None:
    depth = np.full((120, 160), 2000.0, dtype=np.float32)
    depth[40:75, 70:90] = 490.0
    depth[:, 100:] = 0.0
    told = SEGMENTS.segmentation(depth, POSE)
    assert told is not None
    assert set(np.unique(told.labels)) >= {Label.UNREAD, Label.HAND, Label.OTHER}
    picture, step = painted(depth), told.window.step
    inside = 0
    for row in range(told.window.height):
        for column in range(told.window.width):
            u, v = told.window.left + column * step, told.window.top + row * step
            if 0 <= u < 160 and 0 <= v < 120:
                expected = 0.7 * np.array(LABEL_COLOURS[Label(told.labels[row, column])])
                np.testing.assert_allclose(picture[v, u], expected, atol=1.0)
                inside += 1
    assert inside > 1000


def test_outside_the_window_and_without_a_pose_nothing_is_painted() -> None:
    depth = np.full((120, 160), 490.0, dtype=np.float32)
    assert not painted(depth, Shown(points=np.zeros((21, 3)))).any()
    far_left = Shown(np.array([-5000.0, 0.0, 500.0]), POSE.quaternion, POSE.shape)
    assert not painted(depth, far_left).any()


def test_view_draws_observed_and_segments_beside_each_other(tmp_path: Path, device: RenderingDevice) -> None:
    recording = open_recording(make_recording(tmp_path / "r.mcap", frames=1))
    result = read_result(make_result(tmp_path / "result.mcap", recording))
    options = ViewOptions(layout="segments", scale=1.0)
    view = ResultView([result], recording, options, lambda: device)
    ((_, picture),) = view.pictures()
    assert picture.shape[1] == 2 * KINECT.width
    panel = picture[: KINECT.height, KINECT.width :].astype(int)
    u, v = KINECT.pixels_from_points(truth_of(recording)[0].points[9])[0].round().astype(int)
    greenest = panel[v - 3 : v + 4, u - 3 : u + 4].reshape(-1, 3).mean(axis=0)
    assert greenest[1] > greenest[0] + 30 and greenest[1] > greenest[2] + 30


def test_a_record_without_a_hand_s_configuration_is_refused() -> None:
    with pytest.raises(ResultError, match="no hand configuration"):
        configuration_of({"configuration": "{}x"})
    assert configuration_of({"configuration": HandConfig().model_dump_json()}) == HandConfig()
