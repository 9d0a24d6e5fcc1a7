"""Builders of small recordings of grey images, of one or more cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import placed
from posetrack_cli.recording.camera_file import camera_file_text

WIDTH, HEIGHT = 32, 24
PERIOD_NS = 33_333_333
START_NS = 1_700_000_000_000_000_000
TURN = np.array([[0.96, 0.0, 0.28], [0.0, 1.0, 0.0], [-0.28, 0.0, 0.96]])


def rig(names: Sequence[str] = ("left", "right")) -> list[Camera]:
    """Cameras in a row, each turned and 100 mm beside the one before."""
    first = Camera(WIDTH, HEIGHT, 40.0, 41.0, 15.0, 12.0, (-0.1, 0.02, 0.0, 0.0, 0.0))
    cameras, place = [], np.column_stack([np.eye(3), np.zeros(3)])
    for name in names:
        cameras.append(placed(Camera(**{**first.__dict__, "name": name}), place))
        place = np.column_stack([TURN @ place[:, :3], place[:, 3] + [-100.0, 0.0, 15.0]])
    return cameras


def grey_images(count: int, seed: int = 0) -> list[np.ndarray]:
    """Random images, no two equal."""
    rng = np.random.default_rng(seed)
    return list(rng.integers(0, 256, (count, HEIGHT, WIDTH), dtype=np.uint8))


def stamps(count: int, offset_ns: int = 0) -> list[int]:
    return [START_NS + offset_ns + i * PERIOD_NS for i in range(count)]


def write_images(
    folder: Path,
    images: Sequence[np.ndarray | None],
    names: Sequence[str] | None = None,
    suffix: str = ".png",
) -> Path:
    """Write images, leaving out those that are None."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, image in enumerate(images):
        if image is not None:
            name = names[index] if names else f"{index:06d}"
            (folder / f"{name}{suffix}").write_bytes(cv2.imencode(suffix, image)[1].tobytes())
    return folder


def write_stamps(folder: Path, values: Sequence[int], names: Sequence[str] | None = None) -> None:
    rows = (
        [f"{name},{value}" for name, value in zip(names, values, strict=True)] if names else map(str, values)
    )
    header = "filename,stamp_ns" if names else "stamp_ns"
    (folder / "timestamps.csv").write_text("\n".join([header, *rows]) + "\n")


def write_rig(
    path: Path, cameras: Mapping[str, Sequence[np.ndarray | None]], count: int | None = None
) -> Path:
    """A folder with a folder per camera, camera.toml, and stamps for ``count`` instants."""
    for name, images in cameras.items():
        write_images(path / name, images)
    (path / "camera.toml").write_text(camera_file_text(rig(list(cameras))))
    write_stamps(path, stamps(count or max(len(images) for images in cameras.values())))
    return path
