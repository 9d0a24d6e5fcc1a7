"""One scene, stored in every way that a camera's pixels are stored in: commands give one answer.

A hand in depth and a head in grey images are made once. Each way below stores them under another calibration
of the same pixels, or the same calibration otherwise; where the images are equal, so must the estimates be.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.geometry.camera import Camera, pixel_map
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results import load_arrays

Images = Sequence[tuple[int, np.ndarray]]
"""Stamp, ns, and image as it is stored."""
Way = Callable[[SimpleNamespace, Path, Images, Camera], Path]
TOPIC, INFO = "/camera/depth/image_raw", "/camera/depth/camera_info"
RESAMPLED_MM = 2.0
"""Nearest pixels move an outline by half a pixel, .7 mm at 500 mm, and what shows of the hand with it."""


def k_of(camera: Camera) -> list[float]:
    return [float(value) for value in camera.matrix.ravel()]


def p_of(camera: Camera) -> list[float]:
    return [float(value) for value in np.column_stack([camera.matrix, np.zeros(3)]).ravel()]


def messages(
    make: SimpleNamespace, path: Path, images: Images, camera: Camera, topic: str = TOPIC, **fields: Any
) -> Path:
    """Store images with a CameraInfo for each, of which some fields are given."""
    own = {"width": camera.width, "height": camera.height, "k": k_of(camera), "p": p_of(camera), "d": []}
    own |= {"distortion_model": "plumb_bob", "r": [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0], **fields}
    stored = []
    for stamp, image in images:
        encoding = "16UC1" if image.dtype == np.uint16 else "mono8"
        stored.append((INFO, "CameraInfo", stamp, stamp, own))
        stored.append((topic, "Image", stamp, stamp + 1000, make.raw_fields(image, encoding)))
    return make.write_ros2(path.with_suffix(".mcap"), stored)  # type: ignore[no-any-return]


def as_it_is(make: SimpleNamespace, path: Path, images: Images, camera: Camera) -> Path:
    return messages(make, path, images, camera)


def rectified(make: SimpleNamespace, path: Path, images: Images, camera: Camera) -> Path:
    """K and D are of the raw image, which is not recorded."""
    raw = k_of(replace(camera, fx=1.1 * camera.fx, fy=1.1 * camera.fy, cx=camera.cx - 9.5))
    d = [0.18, -0.3, 0.001, -0.002, 0.0]
    return messages(make, path, images, camera, TOPIC.replace("image_raw", "image_depth_rect"), k=raw, d=d)


def binned(make: SimpleNamespace, path: Path, images: Images, camera: Camera) -> Path:
    sensor = camera.scaled(2 * camera.width, 2 * camera.height)
    size = {"width": sensor.width, "height": sensor.height}
    return messages(make, path, images, camera, k=k_of(sensor), binning_x=2, binning_y=2, **size)


def part_of_sensor(make: SimpleNamespace, path: Path, images: Images, camera: Camera) -> Path:
    width, height = camera.width, camera.height
    sensor = replace(camera, width=width + 128, height=height + 96, cx=camera.cx + 32, cy=camera.cy + 64)
    roi = {"x_offset": 32, "y_offset": 64, "width": width, "height": height, "do_rectify": False}
    size = {"width": sensor.width, "height": sensor.height}
    return messages(make, path, images, camera, k=k_of(sensor), roi=roi, **size)


def another_resolution(make: SimpleNamespace, path: Path, images: Images, camera: Camera) -> Path:
    large = camera.scaled(4 * camera.width, 4 * camera.height)
    return messages(make, path, images, camera, k=k_of(large), width=large.width, height=large.height)


def folder(make: SimpleNamespace, path: Path, images: Images, camera: Camera, more: str = "") -> Path:
    path.mkdir()
    for number, (_, image) in enumerate(images):
        cv2.imwrite(str(path / f"{number:06d}.png"), image)
    values = "".join(f"{key} = {getattr(camera, key)}\n" for key in ("fx", "fy", "cx", "cy"))
    (path / "camera.toml").write_text(values + more)
    (path / "timestamps.csv").write_text("\n".join(["stamp_ns", *(str(stamp) for stamp, _ in images)]))
    return path


def folder_of_another_resolution(make: SimpleNamespace, path: Path, images: Images, camera: Camera) -> Path:
    large = camera.scaled(3 * camera.width, 3 * camera.height)
    return folder(make, path, images, large, f"width = {large.width}\nheight = {large.height}\n")


def mirrored_folder(make: SimpleNamespace, path: Path, images: Images, camera: Camera) -> Path:
    flipped = [(stamp, np.ascontiguousarray(image[:, ::-1])) for stamp, image in images]
    return folder(make, path, flipped, replace(camera, cx=camera.width - 1 - camera.cx), "mirror = true\n")


def cropped_folder(make: SimpleNamespace, path: Path, images: Images, camera: Camera) -> Path:
    framed = [(stamp, cv2.copyMakeBorder(image, 5, 9, 16, 8, cv2.BORDER_REFLECT)) for stamp, image in images]
    crop = f"crop = [16, 5, {camera.width}, {camera.height}]\n"
    return folder(make, path, framed, replace(camera, cx=camera.cx + 16, cy=camera.cy + 5), crop)


SAME_PIXELS: dict[str, Way] = {
    way.__name__: way
    for way in (
        rectified,
        binned,
        part_of_sensor,
        another_resolution,
        folder,
        folder_of_another_resolution,
        mirrored_folder,
        cropped_folder,
    )
}


def through_a_lens(model: str, coefficients: Sequence[float], named: str = "") -> Way:
    """Return a way that stores what a lens would show, each pixel the nearest of the scene."""

    def store(make: SimpleNamespace, path: Path, images: Images, camera: Camera) -> Path:
        lens = replace(camera, distortion=tuple(coefficients), distortion_model=model)
        u, v = pixel_map(lens, camera)
        seen = [
            (stamp, cv2.remap(image, np.rint(u), np.rint(v), cv2.INTER_NEAREST)) for stamp, image in images
        ]
        stated = {"d": list(coefficients), "distortion_model": named or model}
        return messages(make, path, seen, camera, **stated)

    return store


def changing(make: SimpleNamespace, path: Path, images: Images, camera: Camera) -> Path:
    """From the second image on the camera is another, and its calibration with it."""
    other = replace(camera, fx=1.08 * camera.fx, fy=1.08 * camera.fy, cx=camera.cx + 7.0)
    u, v = pixel_map(other, camera)
    stored = []
    for number, (stamp, image) in enumerate(images):
        lens = other if number else camera
        seen = cv2.remap(image, np.rint(u), np.rint(v), cv2.INTER_NEAREST) if number else image
        own = make.calibration_fields(camera.width, camera.height, upper=False) | {"k": k_of(lens)}
        stored.append((TOPIC, "Image", stamp, stamp, make.raw_fields(seen, "16UC1")))
        stored.append((INFO, "CameraInfo", stamp, stamp + 500, own))
    return make.write_ros2(path.with_suffix(".mcap"), stored)  # type: ignore[no-any-return]


RESAMPLED: dict[str, Way] = {
    "plumb bob": through_a_lens("plumb_bob", (0.09, -0.2, 0.001, -0.002, 0.05)),
    "rational": through_a_lens("rational_polynomial", (4.7, 3.2, 0.0, 0.0, 0.17, 5.06, 4.78, 0.89)),
    "equidistant": through_a_lens("equidistant", (0.01, -0.02, 0.003, 0.001)),
    "inverse": through_a_lens(
        "inverse_brown_conrady", (0.12, 0.11, 0.004, 0.004, 0.03), "Inverse Brown Conrady"
    ),
    "changing": changing,
}


# Hands


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> tuple[Images, Camera]:
    path = tmp_path_factory.mktemp("hand") / "hand.mcap"
    plain = ["--no-background", "--no-body", "--no-noise", "--no-edges", "--no-drops", "--no-late"]
    assert run(["hand", "synth", "-q", "--frames", "3", "--seed", "5", *plain, "-o", str(path)]) == 0
    recording = open_recording(path)
    images = [(frame.stamp_ns, np.round(frame.depth).astype(np.uint16)) for frame in recording.frames()]
    return images, recording.cameras[0]


def joints_of(path: Path, output: Path) -> np.ndarray:
    """Positions of the 21 joints in each frame (N, 21, 3), mm."""
    few = ["--hand-side", "right", "--shape", "average", "--particles", "64"]
    assert run(["hand", "run", "-q", str(path), "-o", str(output), *few]) == 0
    return np.asarray(load_arrays(output)["points"])


@pytest.fixture(scope="module")
def joints(
    hand: tuple[Images, Camera], make: SimpleNamespace, tmp_path_factory: pytest.TempPathFactory
) -> np.ndarray:
    folder = tmp_path_factory.mktemp("reference")
    return joints_of(as_it_is(make, folder / "r", *hand), folder / "result.mcap")


@pytest.mark.parametrize("way", SAME_PIXELS)
def test_hands_in_the_same_pixels_are_identical(
    way: str, hand: tuple[Images, Camera], joints: np.ndarray, make: SimpleNamespace, tmp_path: Path
) -> None:
    found = joints_of(SAME_PIXELS[way](make, tmp_path / "r", *hand), tmp_path / "result.mcap")
    np.testing.assert_array_equal(found, joints)


@pytest.mark.parametrize("way", RESAMPLED)
def test_hands_in_resampled_pixels_are_at_the_same_place(
    way: str, hand: tuple[Images, Camera], joints: np.ndarray, make: SimpleNamespace, tmp_path: Path
) -> None:
    found = joints_of(RESAMPLED[way](make, tmp_path / "r", *hand), tmp_path / "result.mcap")
    assert np.linalg.norm(found - joints, axis=-1).mean() < RESAMPLED_MM


# Heads


@pytest.fixture(scope="module")
def head(tmp_path_factory: pytest.TempPathFactory) -> tuple[Images, Camera]:
    path = tmp_path_factory.mktemp("head") / "head.mcap"
    few = ["--frames", "6", "--camera-count", "1", "--seed", "4"]
    assert run(["head", "synth", "-q", *few, "-o", str(path)]) == 0
    recording = open_recording(path, "grey")
    images = [(f.stamp_ns, f.images[0]) for f in recording.frames() if f.images[0] is not None]
    return images, recording.cameras[0]


def angles_of(path: Path, output: Path) -> np.ndarray:
    """Quaternions of the head (N, 4), which is tracked in every frame."""
    assert run(["head", "mono", "-q", str(path), "-o", str(output), "--passes", "1"]) == 0
    found = load_arrays(output)
    assert set(found["status"].tolist()) == {"tracking"}
    return np.asarray(found["quaternion"])


@pytest.fixture(scope="module")
def angles(
    head: tuple[Images, Camera], make: SimpleNamespace, tmp_path_factory: pytest.TempPathFactory
) -> np.ndarray:
    folder = tmp_path_factory.mktemp("reference")
    return angles_of(as_it_is(make, folder / "r", *head), folder / "result.mcap")


@pytest.mark.parametrize("way", ["rectified", "part_of_sensor", "mirrored_folder", "another_resolution"])
def test_heads_in_the_same_pixels_are_identical(
    way: str, head: tuple[Images, Camera], angles: np.ndarray, make: SimpleNamespace, tmp_path: Path
) -> None:
    found = angles_of(SAME_PIXELS[way](make, tmp_path / "r", *head), tmp_path / "result.mcap")
    np.testing.assert_array_equal(found, angles)
