"""Pictures as they are shown: EXIF, display matrices, and cameras that follow them."""

from __future__ import annotations

import struct
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.cli.info import report_lines
from posetrack_cli.errors import PosetrackError, RecordingError
from posetrack_cli.geometry.camera import Camera, pixels_from_points
from posetrack_cli.recording.camera_file import Intrinsics
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.grey import decode_shown, grey_like
from posetrack_cli.recording.opening import describe, open_recording
from posetrack_cli.recording.orientation import (
    OF_EXIF,
    UPRIGHT,
    Orientation,
    Picture,
    orientation_of_file,
    orientation_of_matrix,
)
from posetrack_cli.recording.pixels import PixelKind

ROUNDING_PX = 1e-9
CAMERAS = {
    "plain": Camera(640, 480, 500.0, 510.0, 322.0, 236.0),
    "plumb bob": Camera(640, 480, 500.0, 510.0, 322.0, 236.0, (0.1, -0.2, 0.003, -0.005, 0.03)),
    "thin prism": Camera(
        640,
        480,
        500.0,
        510.0,
        322.0,
        236.0,
        (0.3, 0.1, 0.011, -0.023, 0.02, 0.4, 0.1, 0.01, 0.013, -0.02, -0.017, 0.03),
        "rational_polynomial",
    ),
    "fisheye": Camera(640, 480, 500.0, 510.0, 322.0, 236.0, (0.1, -0.02, 0.003, 0.001), "equidistant"),
    "inverse": Camera(
        640, 480, 500.0, 510.0, 322.0, 236.0, (0.1, -0.1, 0.003, -0.005, 0.03), "inverse_brown_conrady"
    ),
}
orientations = st.builds(Orientation, st.booleans(), st.booleans(), st.booleans())


def exif(number: int, order: str = "<") -> bytes:
    entry = struct.pack(f"{order}HHIHH", 274, 3, 1, number, 0)
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}IH", 8, 1)
    return head + entry + bytes(4)


def jpeg(image: np.ndarray, number: int, order: str = "<") -> bytes:
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    block = b"Exif\0\0" + exif(number, order)
    return data[:2] + b"\xff\xe1" + (len(block) + 2).to_bytes(2, "big") + block + data[2:]


def png(image: np.ndarray, number: int) -> bytes:
    import zlib

    data, block = cv2.imencode(".png", image)[1].tobytes(), b"eXIf" + exif(number, ">")
    chunk = struct.pack(">I", len(block) - 4) + block + struct.pack(">I", zlib.crc32(block))
    return data[:33] + chunk + data[33:]


def corners() -> np.ndarray:
    """Another grey in each quarter, (40, 60)."""
    image = np.zeros((40, 60), np.uint8)
    image[:20, :30], image[:20, 30:], image[20:, :30] = 255, 170, 85
    return image


@pytest.mark.parametrize("number", range(1, 9))
@pytest.mark.parametrize("order", "<>")
def test_all_eight_of_exif_are_as_opencv_shows_them(number: int, order: str) -> None:
    data = jpeg(corners(), number, order)
    buffer = np.frombuffer(data, np.uint8)
    stored = cv2.imdecode(buffer, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    shown = orientation_of_file(data).apply(stored)
    np.testing.assert_array_equal(shown, cv2.imdecode(buffer, cv2.IMREAD_GRAYSCALE))


def test_a_png_states_its_orientation_in_a_chunk() -> None:
    assert orientation_of_file(png(corners(), 6)) == OF_EXIF[6]
    assert orientation_of_file(png(corners(), 6)[:40]) == UPRIGHT


@given(
    st.binary(max_size=200),
    st.sampled_from([b"\xff\xd8\xff\xe1", b"\x89PNG\r\n\x1a\n", b"RIFF0000WEBP", b""]),
)
def test_no_bytes_make_it_fail(data: bytes, begin: bytes) -> None:
    assert orientation_of_file(begin + data) in OF_EXIF.values()
    assert orientation_of_matrix(data) in OF_EXIF.values()


@given(orientations)
def test_a_display_matrix_moves_pixels_to_where_they_are_shown(orientation: Orientation) -> None:
    """[x y 1] M is where the container shows a stored pixel, up to where its corner is."""
    stored = corners()
    height, width = stored.shape
    shown_width, shown_height = orientation.stored_size(width, height)
    stamp = np.arange(stored.size, dtype=np.int32).reshape(stored.shape)
    shown = orientation.apply(stamp)
    assert shown.shape == (shown_height, shown_width)
    origin = np.argwhere(shown == stamp[0, 0])[0][::-1]
    along_x = np.argwhere(shown == stamp[0, 1])[0][::-1] - origin
    along_y = np.argwhere(shown == stamp[1, 0])[0][::-1] - origin
    one = 1 << 16
    matrix = (along_x[0] * one, along_x[1] * one, 0, along_y[0] * one, along_y[1] * one, 0, 0, 0, 1 << 30)
    assert orientation_of_matrix(struct.pack("<9i", *(int(v) for v in matrix))) == orientation


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("number", range(1, 9))
def test_a_camera_sees_points_where_the_shown_picture_has_them(name: str, number: int) -> None:
    """A point's pixel in the stored picture, moved as the picture is, is its pixel in the shown one."""
    stored, orientation = CAMERAS[name], OF_EXIF[number]
    shown = orientation.camera(stored)
    assert (shown.width, shown.height) == orientation.stored_size(stored.width, stored.height)
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-200, 200, (20, 2)), rng.uniform(700, 900, 20)])
    u, v = pixels_from_points(stored, points)[0].T
    x, y = points[:, 0].copy(), points[:, 1].copy()
    if orientation.transposed:
        u, v, x, y = v, u, y, x
    if orientation.flipped_x:
        u, x = shown.width - 1 - u, -x
    if orientation.flipped_y:
        v, y = shown.height - 1 - v, -y
    found = pixels_from_points(shown, np.column_stack([x, y, points[:, 2]]))[0]
    np.testing.assert_allclose(found, np.column_stack([u, v]), atol=ROUNDING_PX * 1e3)


def test_a_turned_camera_of_a_rig_keeps_its_place() -> None:
    place = ((1.0, 0.0, 0.0, -120.0), (0.0, 1.0, 0.0, 5.0), (0.0, 0.0, 1.0, 20.0))
    stored = replace(CAMERAS["plain"], camera_T_reference=place)
    shown = OF_EXIF[6].camera(stored)
    centres = [
        -np.array(c.camera_T_reference)[:, :3].T @ np.array(c.camera_T_reference)[:, 3]
        for c in (stored, shown)
    ]
    np.testing.assert_allclose(centres[0], centres[1])
    assert np.linalg.det(np.array(shown.camera_T_reference)[:, :3]) == pytest.approx(1.0)


def test_a_tilted_sensor_is_not_turned() -> None:
    tilted = replace(CAMERAS["thin prism"], distortion=(*CAMERAS["thin prism"].distortion, 0.05, 0.0))
    with pytest.raises(PosetrackError, match="lens model with tilt"):
        OF_EXIF[6].camera(tilted)


# Which picture a camera file describes


def camera_of(orientation: int, size: tuple[int, int] = (480, 640), **values: object) -> Camera:
    own = {"fx": 500.0, "fy": 510.0, "cx": 250.0, "cy": 310.0} | values
    settings = Intrinsics.model_validate(own)
    return settings.stored_camera(*size, picture=Picture(*size, OF_EXIF[orientation]))


def test_sizes_and_the_principal_point_tell_which_picture_a_camera_file_describes() -> None:
    assert camera_of(6).cx == 250.0, "shown: its principal point is in the middle of 480 x 640"
    turned = camera_of(6, cx=310.0, cy=250.0)
    assert (turned.fx, turned.fy, turned.cx, turned.cy) == (510.0, 500.0, 480 - 1 - 250.0, 310.0), "stored"
    stated = camera_of(6, cx=310.0, cy=250.0, width=640, height=480)
    assert stated == turned
    assert camera_of(6, cx=310.0, cy=250.0, picture="stored") == turned
    assert camera_of(3).cx == 250.0, "a picture that is turned by 180 degrees is taken as it is shown"
    assert camera_of(3, picture="stored").cx == 480 - 1 - 250.0


def test_square_pictures_that_are_turned_need_a_statement() -> None:
    size = (480, 480)
    with pytest.raises(RecordingError, match='add picture = "stored"'):
        camera_of(6, size, cx=244.0, cy=232.0)
    assert camera_of(6, size, cx=244.0, cy=232.0, picture="shown").cx == 244.0
    assert camera_of(6, size, cx=244.0, cy=232.0, picture="stored").cx == 480 - 1 - 232.0
    assert camera_of(6, size, cx=239.5, cy=239.5, fx=500.0, fy=500.0).cx == 239.5, "it makes no difference"


def test_a_folder_of_turned_pictures(tmp_path: Path) -> None:
    (tmp_path / "0.jpg").write_bytes(jpeg(corners(), 6))
    (tmp_path / "1.jpg").write_bytes(jpeg(OF_EXIF[6].apply(corners()), 1))
    (tmp_path / "camera.toml").write_text("fx = 60.0\nfy = 61.0\ncx = 29.0\ncy = 20.0\n")
    recording = open_recording(tmp_path, "grey", fps=30)
    (camera,) = recording.cameras
    assert (camera.width, camera.height, camera.fx, camera.cx) == (40, 60, 61.0, 40 - 1 - 20.0)
    first, second = (frame.images[0] for frame in recording.frames())
    assert first is not None and second is not None
    assert np.abs(first.astype(int) - second).max() <= 8, "JPEG compresses along rows and columns alike"
    assert "images are turned 90 degrees clockwise by their EXIF orientation" in recording.remarks


# TIFF, which OpenCV turns itself


def tiff(image: np.ndarray, number: int) -> bytes:
    """Return a TIFF of one strip that states its orientation (TIFF 6.0, section 8)."""
    height, width = image.shape
    tags = {256: width, 257: height, 258: 8 * image.itemsize, 259: 1, 262: 1, 273: 8, 274: number, 277: 1}
    tags |= {278: height, 279: image.nbytes, 339: 1}
    entries = b"".join(struct.pack("<HHIHH", tag, 3, 1, value, 0) for tag, value in tags.items())
    directory = struct.pack("<H", len(tags)) + entries + bytes(4)
    return b"II*\0" + struct.pack("<I", 8 + image.nbytes) + image.tobytes() + directory


@pytest.mark.parametrize("number", range(1, 9))
def test_all_eight_of_tiff_are_shown_once(number: int) -> None:
    data = tiff(corners(), number)
    assert orientation_of_file(data) == OF_EXIF[number]
    np.testing.assert_array_equal(decode_shown(data), OF_EXIF[number].apply(corners()))
    shown = grey_like(decode_shown(data), "image").from_file(data, "image")
    np.testing.assert_array_equal(shown, OF_EXIF[number].apply(corners()))


@pytest.mark.parametrize("kind", ["grey", "depth"])
def test_a_folder_of_turned_tiff(tmp_path: Path, kind: PixelKind) -> None:
    """The camera file describes the stored picture: its size and principal point are those."""
    stored = corners() if kind == "grey" else corners().astype("<u2") + 500
    for k in range(2):
        (tmp_path / f"{k}.tif").write_bytes(tiff(stored, 6))
    (tmp_path / "camera.toml").write_text("fx = 60.0\nfy = 61.0\ncx = 29.0\ncy = 20.0\n")
    recording = open_recording(tmp_path, kind, fps=30)
    (camera,) = recording.cameras
    assert (camera.width, camera.height, camera.fx, camera.cx) == (40, 60, 61.0, 40 - 1 - 20.0)
    frame = next(iter(recording.frames()))
    image = frame.images[0] if kind == "grey" else frame.depth
    np.testing.assert_array_equal(image, OF_EXIF[6].apply(stored))
    remark = "pictures are turned 90 degrees clockwise; camera file describes the stored picture"
    assert remark in recording.remarks


def test_depth_stays_as_it_is_stored_whatever_its_exif_states(tmp_path: Path) -> None:
    """A PNG of depth is not turned by its EXIF, as its reader never did."""
    stored = corners().astype(np.uint16) + 500
    (tmp_path / "0.png").write_bytes(png(stored, 6))
    (tmp_path / "camera.toml").write_text("fx = 60.0\nfy = 61.0\ncx = 29.0\ncy = 20.0\n")
    recording = open_recording(tmp_path, fps=30)
    np.testing.assert_array_equal(next(iter(recording.frames())).depth, stored)
    assert recording.cameras[0].width == 60


# Videos


def video(path: Path, images: list[np.ndarray], matrix: tuple[int, ...] = (), aspect: int = 1) -> Path:
    """Write a video whose container states a display matrix, or pixels that are wider than high."""
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.height, stream.width, stream.pix_fmt = *images[0].shape[:2], "yuv420p"
        stream.bit_rate = 4_000_000
        if aspect != 1:
            stream.codec_context.sample_aspect_ratio = stream.sample_aspect_ratio = Fraction(aspect, 1)
        for image in images:
            frame = av.VideoFrame.from_ndarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), format="bgr24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    if matrix:
        data, upright = bytearray(path.read_bytes()), struct.pack(">9i", *UPRIGHT_MATRIX)
        at = data.index(b"tkhd")
        place = data.index(upright, at)
        data[place : place + 36] = struct.pack(">9i", *matrix)
        path.write_bytes(bytes(data))
    return path


ONE = 1 << 16
UPRIGHT_MATRIX = (ONE, 0, 0, 0, ONE, 0, 0, 0, 1 << 30)
COMPRESSED = 24
"""Grey levels that mpeg4 and its chroma change far from edges."""


@pytest.mark.parametrize(
    ("matrix", "orientation"),
    [
        ((0, ONE, 0, -ONE, 0, 0, 48 * ONE, 0, 1 << 30), OF_EXIF[6]),
        ((-ONE, 0, 0, 0, ONE, 0, 64 * ONE, 0, 1 << 30), OF_EXIF[2]),
        ((0, ONE, 0, ONE, 0, 0, 0, 0, 1 << 30), OF_EXIF[5]),
    ],
)
def test_videos_are_turned_and_mirrored(
    tmp_path: Path, matrix: tuple[int, ...], orientation: Orientation
) -> None:
    """A selfie camera's container mirrors; a quarter turn is a telephone's."""
    picture = cv2.resize(corners(), (64, 48), interpolation=cv2.INTER_NEAREST)
    path = video(tmp_path / "v.mp4", [picture] * 3, matrix)
    recording = open_recording(path, "grey", guess=Guess())
    frame = next(iter(recording.frames())).images[0]
    expected = orientation.apply(picture)
    assert frame is not None and frame.shape == expected.shape
    assert np.median(np.abs(frame.astype(int) - expected)) <= COMPRESSED


def test_pixels_that_are_not_square(tmp_path: Path) -> None:
    """A guessed camera gets square pixels; a camera file is of the pixels that are stored."""
    path = video(tmp_path / "v.avi", [cv2.resize(corners(), (64, 96))] * 3, aspect=2)
    recording = open_recording(path, "grey", guess=Guess())
    (camera,) = recording.cameras
    assert (camera.width, camera.height, camera.fx, camera.fy) == (128, 96, 128.0, 128.0)
    assert recording.remarks == ("pixel aspect ratio is 2: frames are resampled to square pixels",)
    _, images, _, *remarks = report_lines(describe(path))
    assert images.startswith("images: 3, 128x96, ") and tuple(remarks) == recording.remarks
    (tmp_path / "v.toml").write_text("fx = 60.0\nfy = 120.0\ncx = 31.5\ncy = 47.5\n")
    recording = open_recording(path, "grey")
    (camera,) = recording.cameras
    assert (camera.width, camera.height, camera.fx, camera.fy) == (64, 96, 60.0, 120.0)
    remark = "pixel aspect ratio is 2: intrinsics are taken to describe the stored pixels"
    assert recording.remarks == tuple(describe(path)["remarks"]) == (remark,)


def test_an_animated_gif_is_a_video(tmp_path: Path) -> None:
    import av

    with av.open(str(tmp_path / "a.gif"), "w") as container:
        stream = container.add_stream("gif", rate=10)
        stream.width, stream.height, stream.pix_fmt = 60, 40, "rgb8"
        for k in range(3):
            rgb = cv2.cvtColor(np.roll(corners(), 8 * k, axis=1), cv2.COLOR_GRAY2RGB)
            container.mux(
                stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24").reformat(format="rgb8"))
            )
        container.mux(stream.encode(None))
    recording = open_recording(tmp_path / "a.gif", "grey", guess=Guess())
    frames = list(recording.frames())
    assert [frame.stamp_ns for frame in frames] == [0, 100_000_000, 200_000_000]
    assert frames[0].images[0] is not None and frames[0].images[0].shape == (40, 60)
