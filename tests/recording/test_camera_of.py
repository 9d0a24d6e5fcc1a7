"""Which camera model an image has: raw or rectified, part of a sensor, resolution; and how it may change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.errors import PosetrackError, RecordingError
from posetrack_cli.geometry.camera import Camera, normalised_from_pixels, pixels_from_points
from posetrack_cli.recording.camera_file import camera_path, load_depth_camera, nominal_names
from posetrack_cli.recording.camera_of import (
    Calibration,
    Guess,
    Resampling,
    at_size,
    camera_of_message,
    is_rectified,
    is_same,
    namespace_of,
    pair_with_calibration,
    principal_point_fault,
    reprojected_to,
)
from posetrack_cli.recording.opening import describe, open_recording

RAW = Camera(640, 480, 500.0, 505.0, 322.0, 236.0, (0.1, -0.2, 0.001, -0.002, 0.03))
RECTIFIED = Camera(640, 480, 470.0, 470.0, 310.0, 244.0)
ROUNDING_PX = 1e-9

cameras = st.builds(
    Camera,
    st.integers(64, 2000),
    st.integers(64, 2000),
    st.floats(100, 3000),
    st.floats(100, 3000),
    st.floats(20, 40),
    st.floats(20, 40),
)


def of(
    calibration: Calibration, size: tuple[int, int] = (640, 480), rectified: bool = False
) -> tuple[Camera, str]:
    found = camera_of_message(
        calibration, size, rectified=rectified, name="camera", topic="/info", images="/image"
    )
    return found.camera, found.why


def parameters(camera: Camera) -> tuple[float, ...]:
    return (camera.fx, camera.fy, camera.cx, camera.cy)


def test_raw_images_have_k_and_d_rectified_ones_p() -> None:
    calibration = Calibration(640, 480, RAW, RECTIFIED)
    assert of(calibration) == (RAW, "K of /info, raw images")
    camera, why = of(calibration, rectified=True)
    assert (parameters(camera), camera.distortion) == (parameters(RECTIFIED), ())
    assert why == "P of /info, rectified images"
    camera, why = of(Calibration(640, 480, RAW, None), rectified=True)
    assert (parameters(camera), camera.distortion, why[0]) == (parameters(RAW), (), "K")
    with pytest.raises(PosetrackError, match="not calibrated"):
        of(Calibration(640, 480, None, RECTIFIED))


@given(cameras, st.integers(2, 4))
def test_a_binned_pixel_sees_what_its_pixels_see(camera: Camera, binning: int) -> None:
    """The middle of a binned pixel is the middle of its block: u_small = (u + 1/2) / b - 1/2."""
    whole = replace(camera, width=binning * 320, height=binning * 240, cx=binning * 150.0, cy=binning * 120.0)
    small, why = of(Calibration(whole.width, whole.height, whole, None, (binning, binning)), (320, 240))
    point = np.array([30.0, -20.0, 800.0])
    at, within = (pixels_from_points(c, point)[0] for c in (small, whole))
    np.testing.assert_allclose(at, (within + 0.5) / binning - 0.5, atol=ROUNDING_PX * 1e3)
    assert f"binned {binning}x{binning}" in why


def test_a_part_of_the_sensor_is_counted_from_its_corner() -> None:
    calibration = Calibration(640, 480, RAW, RECTIFIED, roi=(100, 60, 400, 300))
    camera, why = of(calibration, (400, 300))
    assert parameters(camera) == (500.0, 505.0, 222.0, 176.0)
    assert "region 400x300 at 100, 60" in why
    binned = replace(calibration, binning=(2, 2))
    assert parameters(of(binned, (200, 150))[0]) == (250.0, 252.5, 110.75, 87.75)
    assert of(calibration)[0] == RAW, "images of the whole sensor have all of it"


def test_binning_that_the_stated_size_has_already() -> None:
    """Drivers that state the size of the delivered images, with K of it or of the whole sensor."""
    assert of(Calibration(640, 480, RAW, None, (2, 2)))[0] == RAW
    whole = replace(RAW, fx=1000.0, fy=1010.0, cx=640.0, cy=480.0)
    camera, why = of(Calibration(640, 480, whole, None, (2, 2)))
    assert (parameters(camera), why[-10:]) == ((500.0, 505.0, 319.75, 239.75), "binned 2x2")


@pytest.mark.parametrize(
    ("size", "says"),
    [
        ((480, 640), "images are rotated relative to their calibration, found 640x480, expected 480x640"),
        ((640, 400), "calibration and images differ in size, found 640x480, expected 640x400 as on /image"),
        ((848, 480), "differ in size"),
    ],
)
def test_images_that_a_calibration_does_not_fit(size: tuple[int, int], says: str) -> None:
    with pytest.raises(RecordingError, match=says):
        of(Calibration(640, 480, RAW, None), size)


@given(cameras, st.sampled_from([0.25, 0.5, 2.0, 3.0]))
def test_another_resolution_sees_the_same_rays(camera: Camera, factor: float) -> None:
    camera = replace(camera, width=camera.width // 4 * 4, height=camera.height // 4 * 4)
    other = at_size(camera, round(factor * camera.width), round(factor * camera.height))
    assert other is not None
    edges = np.array([[-0.5, -0.5], [camera.width - 0.5, camera.height - 0.5]])
    rays = (edges - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    there = rays * [other.fx, other.fy] + [other.cx, other.cy]
    expected = [[-0.5, -0.5], [other.width - 0.5, other.height - 0.5]]
    np.testing.assert_allclose(there, expected, atol=1e-6)
    assert at_size(other, camera.width, camera.height) is not None


@given(
    st.floats(0.9, 1.1), st.floats(0.9, 1.1), st.sampled_from([0.25, 0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2, 7.5])
)
def test_a_principal_point_of_another_resolution_is_noticed(
    across: float, down: float, factor: float
) -> None:
    """Lenses are off the middle by up to 2 %; what a crop does is not at one multiple in both directions."""
    right = Camera(640, 480, 500.0, 500.0, 320.0 * (0.98 + 0.04 * (across - 0.9) * 5) - 0.5, 239.5)
    assert principal_point_fault(right) is None
    other = right.scaled(round(640 * factor), round(480 * factor))
    assert principal_point_fault(replace(other, width=640, height=480)) is not None
    crop = replace(right, width=400, height=240, cx=right.cx - 220, cy=right.cy - 40 * down)
    assert principal_point_fault(crop) is None


@pytest.mark.parametrize(
    ("topic", "rectified"),
    [
        ("/camera/depth/image_rect", True),
        ("/kinect2/qhd/image_depth_rect", True),
        ("/kinect2/qhd/image_color_rect/compressed", True),
        ("/camera/depth_registered/image_rect_raw", True),
        ("/stereo/left/image_rect_color", True),
        ("/rectified/left/image", True),
        ("/camera/depth/image_raw", False),
        ("/camera/direct/image", False),
        ("/correct/image", False),
    ],
)
def test_names_of_rectified_images(topic: str, rectified: bool) -> None:
    assert is_rectified(topic) == rectified


def test_namespaces_and_cameras_that_depth_was_reprojected_to() -> None:
    assert namespace_of("/camera/depth/image_raw/compressedDepth") == "/camera/depth"
    assert namespace_of("/device_0/sensor_0/Depth_0/image/data") == "/device_0/sensor_0/Depth_0"
    assert namespace_of("/image") == ""
    assert "color" in reprojected_to("/camera/aligned_depth_to_color/image_raw")
    assert "rgb" in reprojected_to("/camera/depth_registered/image_raw")
    assert reprojected_to("/camera/aligned_depth_to_infra1/image_raw") == ("infra1",)
    assert reprojected_to("/camera/depth/image_raw") == ()


# Through files


def write(make: SimpleNamespace, path: Path, infos: list[Any], topic: str, **fields: Any) -> Path:
    frames = [
        (topic, "Image", stamp, stamp, make.raw_fields(codes, "16UC1") | fields)
        for stamp, codes in zip(make.stamps(3), make.depth_codes(3), strict=True)
    ]
    return make.write_ros2(path, [*infos, *frames])  # type: ignore[no-any-return]


def info(make: SimpleNamespace, topic: str, stamp: int | None = None, **fields: Any) -> Any:
    own = make.calibration_fields(upper=False) | fields
    return topic, "CameraInfo", make.START_NS if stamp is None else stamp, stamp or make.START_NS - 5, own


def k_of(fx: float, fy: float, cx: float, cy: float) -> list[float]:
    return [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]


def test_a_rectified_depth_topic_has_p(tmp_path: Path, make: SimpleNamespace) -> None:
    p = [28.0, 0, 11.5, 0, 0, 29.0, 8.0, 0, 0, 0, 1.0, 0]
    raw = {"d": [0.2, -0.3, 0.0, 0.0, 0.0], "p": p}
    path = write(make, tmp_path / "r.mcap", [info(make, "/depth/camera_info", **raw)], "/depth/image_rect")
    (camera,) = open_recording(path).cameras
    assert (parameters(camera), camera.distortion) == ((28.0, 29.0, 11.5, 8.0), ())
    (use,) = describe(path)["used"]
    assert use["cameras"][0]["why"] == "P of /depth/camera_info, rectified images"
    path = write(make, tmp_path / "raw.mcap", [info(make, "/depth/camera_info", **raw)], "/depth/image_raw")
    (camera,) = open_recording(path).cameras
    assert (parameters(camera), camera.distortion[0]) == ((30.0, 31.0, 11.0, 7.5), 0.2)


def test_binning_and_roi_of_a_message(tmp_path: Path, make: SimpleNamespace) -> None:
    fields = {
        "width": 80,
        "height": 60,
        "k": k_of(60.0, 62.0, 44.5, 35.5),
        "binning_x": 2,
        "binning_y": 2,
        "roi": {"x_offset": 22, "y_offset": 20, "width": 48, "height": 32, "do_rectify": False},
    }
    path = write(make, tmp_path / "r.mcap", [info(make, "/cam/info", **fields)], "/cam/image")
    recording = open_recording(path)
    assert parameters(recording.cameras[0]) == (30.0, 31.0, 11.0, 7.5)
    assert recording.remarks == (
        "camera of 24x16 images: K of /cam/info, raw images, region 48x32 at 22, 20, binned 2x2",
    )


def test_a_calibration_of_another_resolution_is_scaled_and_reported(
    tmp_path: Path, make: SimpleNamespace
) -> None:
    fields = {"width": 48, "height": 32, "k": k_of(60.0, 62.0, 22.5, 15.5)}
    path = write(make, tmp_path / "r.mcap", [info(make, "/cam/info", **fields)], "/cam/image")
    recording = open_recording(path)
    assert parameters(recording.cameras[0]) == (30.0, 31.0, 11.0, 7.5)
    assert "scaled from 48x32" in recording.remarks[0]


def test_a_matrix_that_does_not_follow_the_mode_is_refused(tmp_path: Path, make: SimpleNamespace) -> None:
    """The driver states the size of the images and the matrix of another mode."""
    fields = {"k": k_of(45.0, 46.0, 17.5, 11.5)}
    path = write(make, tmp_path / "r.mcap", [info(make, "/cam/info", **fields)], "/cam/image")
    with pytest.raises(RecordingError, match=r"principal point is at 1\.5 times the image centre") as caught:
        open_recording(path)
    assert "/cam/info" in str(caught.value)
    assert "--camera" in str(caught.value)


def test_the_first_calibrations_may_be_empty(tmp_path: Path, make: SimpleNamespace) -> None:
    empty = info(make, "/cam/info", make.START_NS - 100, k=[0.0] * 9)
    path = write(make, tmp_path / "r.mcap", [empty, info(make, "/cam/info")], "/cam/image")
    assert parameters(open_recording(path).cameras[0]) == (30.0, 31.0, 11.0, 7.5)


@pytest.mark.parametrize(
    ("model", "coefficients", "stored"),
    [
        ("Inverse Brown Conrady", [0.1, 0.2, 0.01, 0.02, 0.03], ("inverse_brown_conrady", 5)),
        ("Brown Conrady", [0.1, 0.2, 0.01, 0.02, 0.03], ("plumb_bob", 5)),
        ("Kannala Brandt4", [0.1, 0.02, 0.01, 0.001, 0.0], ("equidistant", 4)),
        ("plumb_bob", [0.1, 0.2, 0.01, 0.02, 0.03, 0.1, 0.2, 0.1], ("rational_polynomial", 8)),
        ("rational_polynomial", [0.1, 0.2, 0.01, 0.02, 0.03], ("plumb_bob", 5)),
    ],
)
def test_names_of_distortion_models(
    tmp_path: Path, make: SimpleNamespace, model: str, coefficients: list[float], stored: tuple[str, int]
) -> None:
    fields = {"distortion_model": model, "d": coefficients}
    path = write(make, tmp_path / "r.mcap", [info(make, "/cam/info", **fields)], "/cam/image")
    (camera,) = open_recording(path).cameras
    assert (camera.distortion_model, len(camera.distortion)) == stored


def test_depth_that_was_reprojected_has_the_calibration_of_that_camera(
    tmp_path: Path, make: SimpleNamespace
) -> None:
    """RealSense's driver once gave aligned depth the frame of the depth camera."""
    infos = [
        info(make, "/camera/depth/camera_info", frame_id="depth_frame"),
        info(make, "/camera/color/camera_info", frame_id="color_frame", k=k_of(40.0, 41.0, 12.0, 8.0)),
    ]
    topic, frame = "/camera/aligned_depth_to_color/image_raw", {"frame_id": "depth_frame"}
    path = write(make, tmp_path / "r.mcap", infos, topic, **frame)
    assert open_recording(path).cameras[0].fx == 40.0
    own = info(make, "/camera/aligned_depth_to_color/camera_info", k=k_of(50.0, 51.0, 12.0, 8.0))
    path = write(make, tmp_path / "own.mcap", [*infos, own], topic, **frame)
    assert open_recording(path).cameras[0].fx == 50.0
    path = write(make, tmp_path / "none.mcap", infos[:1], topic, **frame)
    with pytest.raises(RecordingError, match="no calibration of the camera to which depth was reprojected"):
        open_recording(path)


def test_the_only_calibration_may_be_another_camera_s(tmp_path: Path, make: SimpleNamespace) -> None:
    infos = [info(make, "/camera/color/camera_info", frame_id="color_frame")]
    path = write(make, tmp_path / "r.mcap", infos, "/camera/depth/image_raw", frame_id="depth_frame")
    with pytest.raises(RecordingError) as caught:
        open_recording(path)
    for words in ("frame 'color_frame'", "frame 'depth_frame'", "--camera-topic /camera/color/camera_info"):
        assert words in str(caught.value)
    assert open_recording(path, camera_topic="/camera/color/camera_info").cameras[0].fx == 30.0


def test_a_calibration_that_changes_is_applied_frame_by_frame(tmp_path: Path, make: SimpleNamespace) -> None:
    """One scene, a ramp in depth, whose later images are taken under another calibration."""
    first = Camera(24, 16, 30.0, 31.0, 11.0, 7.5)
    later = Camera(24, 16, 33.0, 34.0, 12.0, 8.5)
    messages = []
    for number, stamp in enumerate(make.stamps(4)):
        camera = first if number < 2 else later
        fields = make.calibration_fields(upper=False) | {"k": camera.matrix.ravel().tolist()}
        messages.append(("/cam/image", "Image", stamp, stamp, make.raw_fields(ramp(camera), "16UC1")))
        messages.append(("/cam/info", "CameraInfo", stamp, stamp + 1000, fields))  # after its image
    recording = open_recording(make.write_ros2(tmp_path / "r.mcap", messages))
    frames = [frame.depth for frame in recording.frames()]
    np.testing.assert_array_equal(frames[1], ramp(first))
    for depth in frames[2:]:
        there = depth > 0
        assert there.mean() > 0.8, "the later camera sees a little less"
        # the nearest pixel is at most half a pixel away in both directions
        assert np.abs(depth - ramp(first))[there].max() <= 0.5 * (SLOPE_X + SLOPE_Y) * 31.0 / 33.0 + 1.0
        assert np.abs(depth - ramp(later))[there].mean() > 10.0, "it is another picture"
    assert recording.notes == ("/cam/info changes: images are resampled to the first calibration",)


SLOPE_X, SLOPE_Y = 40.0, 50.0
"""Codes per pixel of the ramp, at a focal length of 30."""


def ramp(camera: Camera) -> np.ndarray:
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    return np.round(5000.0 + 30.0 * (SLOPE_X * x + SLOPE_Y * y)).astype(np.uint16)


def test_a_last_digit_of_a_calibration_is_no_change() -> None:
    assert is_same(RAW, replace(RAW, cx=RAW.cx + 0.01))
    assert not is_same(RAW, replace(RAW, cx=RAW.cx + 0.2))
    image = np.arange(12, dtype=np.uint8).reshape(3, 4)
    camera = Camera(4, 3, 4.0, 4.0, 1.5, 1.0)
    np.testing.assert_array_equal(Resampling(camera, camera).apply(image), image)


@given(st.lists(st.booleans(), max_size=30))
def test_every_image_gets_the_calibration_of_its_stamp(written_after: list[bool]) -> None:
    """Whether a driver writes a calibration before or after its image."""
    items: list[tuple[bool, int, Any]] = []
    for stamp, after in enumerate(written_after):
        pair = [(True, stamp, f"calibration {stamp}"), (False, stamp, stamp)]
        items += reversed(pair) if after else pair
    paired = list(pair_with_calibration(items))
    assert paired == [(stamp, f"calibration {stamp}") for stamp in range(len(written_after))]


# Camera files


@pytest.fixture
def folder(tmp_path: Path, make: SimpleNamespace) -> Callable[[str], Path]:
    def write(camera: str) -> Path:
        return make.write_folder(tmp_path / "r", make.depth_codes(2), camera=camera)  # type: ignore[no-any-return]

    return write


def test_a_camera_file_of_another_resolution_is_scaled(folder: Callable[[str], Path]) -> None:
    recording = open_recording(
        folder("width = 48\nheight = 32\nfx = 60.0\nfy = 62.0\ncx = 22.5\ncy = 15.5\n")
    )
    assert parameters(recording.cameras[0]) == (30.0, 31.0, 11.0, 7.5)
    assert recording.remarks == ("camera file is for 48x32: intrinsics are scaled to 24x16",)
    assert recording.why == ("camera.toml",)


def test_a_matrix_of_other_images_is_refused_with_the_scaled_one(folder: Callable[[str], Path]) -> None:
    path = folder("fx = 45.0\nfy = 46.5\ncx = 17.5\ncy = 11.5\n")
    with pytest.raises(RecordingError) as caught:
        open_recording(path)
    for words in (
        str(path),
        "at 1.5 times the image centre",
        "belong to 36x24 images",
        "use the scaled values fx = 30, fy = 31",
    ):
        assert words in str(caught.value)
    (path / "camera.toml").write_text("width = 24\nheight = 16\nfx = 45.0\nfy = 46.5\ncx = 17.5\ncy = 11.5\n")
    assert open_recording(path).cameras[0].cx == 17.5, "a stated size is believed"
    (path / "camera.toml").write_text("width = 24\nheight = 16\nfx = 45.0\nfy = 46.5\ncx = 31\ncy = 11.5\n")
    with pytest.raises(RecordingError, match="outside the image"):
        open_recording(path)


def test_nominal_cameras(tmp_path: Path, make: SimpleNamespace) -> None:
    images = [np.full((424, 512), 900, np.uint16)]
    path = make.write_folder(tmp_path / "r", images, camera=None, stamp_lines=[])
    with pytest.raises(RecordingError, match="--camera kinect2"):
        open_recording(path)
    recording = open_recording(path, camera_file=Path("kinect2"))
    assert recording.cameras[0].fx == 365.0
    assert "kinect2 is nominal, not calibrated" in recording.remarks[0]
    assert [frame.stamp_ns for frame in recording.frames()] == [0]
    assert recording.identity()["fps"] == "30.0"
    with pytest.raises(PosetrackError, match="did you mean 'kinect2'"):
        open_recording(path, camera_file=Path("kinetc2"))
    assert nominal_names(320, 288) == ["azure-nfov"]


@pytest.mark.parametrize("name", [*nominal_names(640, 480), "azure-nfov", "kinect2", "l515"])
def test_nominal_cameras_have_the_field_of_view_of_their_sensor(name: str) -> None:
    """Against published widths, degrees, which are rounded and differ by some degrees between devices."""
    settings = load_depth_camera(camera_path(Path(name)))
    assert settings.width is not None
    assert settings.height is not None
    camera = settings.stored_camera(settings.width, settings.height)
    published = {"kinect1": 58, "kinect2": 70, "d435-640": 79, "sr300": 68, "l515": 70, "azure-nfov": 75}
    edges = np.array([[-0.5, camera.cy], [camera.width - 0.5, camera.cy]])
    rays = normalised_from_pixels(camera, edges)[:, 0]
    degrees = float(np.degrees(np.arctan(rays[1]) - np.arctan(rays[0])))
    assert degrees == pytest.approx(published[name], abs=6.0)


def test_guesses_stay_in_the_middle() -> None:
    assert principal_point_fault(Guess().stored_camera(641, 480)) is None


def test_opencv_scales_pictures_as_cameras_are_scaled() -> None:
    """A picture that is shrunk by OpenCV keeps rays where ``Camera.scaled`` has them."""
    ramp_px = np.tile(np.arange(64, dtype=np.float32), (48, 1))
    small = cv2.resize(ramp_px, (16, 12), interpolation=cv2.INTER_AREA)
    camera = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
    scaled = camera.scaled(16, 12)
    columns = (np.arange(16) - scaled.cx) / scaled.fx * camera.fx + camera.cx
    np.testing.assert_allclose(small[6], columns, atol=1e-4)
