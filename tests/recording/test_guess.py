"""One camera that is not calibrated: what is guessed of it, by which reader, and where nothing is."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.camera_file import camera_file_text
from posetrack_cli.recording.camera_of import Guess, guess_of_camera, guess_of_field
from posetrack_cli.recording.opening import open_recording
from support.images import HEIGHT, WIDTH, grey_images, rig, stamps, write_images, write_rig, write_stamps

FRAMES = 3
GUESSED = Camera(WIDTH, HEIGHT, 32.0, 32.0, 15.5, 11.5)
"""Of 32 x 24 pixels: the focal length is the longer side's, the axis goes through the middle."""
CHOOSE = r"several cameras, found left, right, expected one; choose one with --cameras"


def test_the_focal_length_follows_the_field_of_view_of_the_longer_side() -> None:
    for size in ((640, 480), (480, 640)):
        camera = guess_of_field(90.0).stored_camera(*size)
        assert camera.fx == camera.fy == pytest.approx(320.0)
        assert guess_of_camera(camera).focal == pytest.approx(0.5)
    assert 2 * math.degrees(math.atan(0.5 / Guess().focal)) == pytest.approx(53.13, abs=0.01)


@pytest.mark.parametrize("fov", [0.0, -50.0, 180.0, float("nan"), float("inf")])
def test_what_no_lens_sees_is_refused(fov: float) -> None:
    with pytest.raises(UsageError, match=r"^--fov out of range, found .*, expected degrees from 1 to 170$"):
        guess_of_field(fov)


@pytest.fixture(params=["folder", "mcap", "uncalibrated mcap", "video"])
def uncalibrated(request: pytest.FixtureRequest, tmp_path: Path, make: SimpleNamespace) -> Path:
    """A recording of one camera of which nothing tells the intrinsics."""
    if request.param == "folder":
        path = write_images(tmp_path / "images", grey_images(FRAMES))
        write_stamps(path, stamps(FRAMES))
        return path
    if request.param == "video":
        return video(tmp_path / "face.avi")
    told = {"K": [0.0] * 9, "D": [], "width": WIDTH, "height": HEIGHT, "frame_id": "camera"}
    info = [("/face/camera_info", "CameraInfo", stamps(1)[0], stamps(1)[0], told)]
    found = images_of(make, "/face/image_raw", "camera")
    return write_mcap(make, tmp_path / "face.mcap", [*info[: " " in request.param], *found])


def video(path: Path) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (WIDTH, HEIGHT))
    for image in grey_images(FRAMES):
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


def images_of(make: SimpleNamespace, topic: str, frame: str) -> list[Any]:
    return [
        (topic, "Image", stamp, stamp, make.raw_fields(image, "mono8") | {"frame_id": frame})
        for stamp, image in zip(stamps(FRAMES), grey_images(FRAMES), strict=True)
    ]


def write_mcap(make: SimpleNamespace, path: Path, found: list[Any], flavour: str = "ros1") -> Path:
    return make.WRITERS[flavour](path, found)  # type: ignore[no-any-return]


def test_every_reader_guesses_when_it_may_and_else_refuses(uncalibrated: Path) -> None:
    recording = open_recording(uncalibrated, "grey", guess=Guess())
    assert recording.is_guessed
    assert recording.cameras == (GUESSED,)
    assert len(list(recording.frames())) == FRAMES
    assert recording.identity()["sha256"]
    with pytest.raises(RecordingError, match=r"not calibrated|no intrinsics"):
        open_recording(uncalibrated, "grey")


def test_a_camera_file_that_is_given_is_no_guess(uncalibrated: Path, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text("fx = 70.0\nfy = 71.0\ncx = 15.0\ncy = 12.0\n")
    recording = open_recording(uncalibrated, "grey", camera_file=file, guess=Guess())
    assert not recording.is_guessed
    assert recording.cameras[0].fx == 70.0


def test_a_mirrored_image_s_axis_stays_in_the_middle(uncalibrated: Path) -> None:
    (camera,) = open_recording(uncalibrated, "grey", guess=Guess(), mirror=True).cameras
    assert (camera.cx, camera.cy) == (15.5, 11.5)


def test_calibrations_are_used_and_faults_in_them_are_still_told(tmp_path: Path) -> None:
    path = write_rig(tmp_path, {"left": grey_images(FRAMES)})
    (tmp_path / "camera.toml").write_text(camera_file_text(rig()[:1]))
    recording = open_recording(path, "grey", guess=Guess())
    assert (recording.is_guessed, recording.cameras[0].fx) == (False, 40.0)
    (tmp_path / "camera.toml").write_text("fx = 'wide'")
    with pytest.raises(RecordingError, match="invalid value for 'fx'"):
        open_recording(path, "grey", guess=Guess())


@pytest.mark.parametrize("calibrated", [True, False])
def test_one_of_several_folders_is_chosen(tmp_path: Path, calibrated: bool) -> None:
    path = write_rig(tmp_path, {"left": grey_images(FRAMES), "right": grey_images(FRAMES, seed=1)})
    if not calibrated:
        (path / "camera.toml").unlink()
    with pytest.raises(UsageError, match=CHOOSE):
        open_recording(path, "grey", guess=Guess())
    recording = open_recording(path, "grey", cameras=["right"], guess=Guess())
    assert ([camera.name for camera in recording.cameras], recording.is_guessed) == (
        ["right"],
        not calibrated,
    )
    np.testing.assert_array_equal(recording.cameras[0].camera_T_reference, np.eye(3, 4))
    (first, *_) = recording.frames()
    np.testing.assert_array_equal(first.images[0], grey_images(FRAMES, seed=1)[0])
    with pytest.raises(RecordingError, match=r"no camera 'rigth'.* did you mean 'right'\?"):
        open_recording(path, "grey", cameras=["rigth"], guess=Guess())


def test_one_of_several_topics_is_chosen(tmp_path: Path, make: SimpleNamespace) -> None:
    found = [m for name in ("left", "right") for m in images_of(make, f"/stereo/{name}/image_raw", name)]
    path = write_mcap(make, tmp_path / "two.mcap", sorted(found, key=lambda message: message[3]))
    with pytest.raises(UsageError, match=CHOOSE):
        open_recording(path, "grey", guess=Guess())
    recording = open_recording(path, "grey", cameras=["right"], guess=Guess())
    assert [camera.name for camera in recording.cameras] == ["right"]
    assert recording.identity()["calibration"] == "guessed"


def test_a_lone_camera_has_no_name_to_ask_for(tmp_path: Path) -> None:
    path = video(tmp_path / "face.avi")
    with pytest.raises(RecordingError, match=r"face\.avi: no camera 'left'; .* omit --cameras"):
        open_recording(path, "grey", cameras=["left"], guess=Guess())
