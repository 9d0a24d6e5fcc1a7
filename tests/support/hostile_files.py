"""Small inputs of every command, for tests of what lies in the place of a file."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from support.eval_command import write_result

CAMERA = "fx = 9.0\nfy = 9.0\ncx = 3.0\ncy = 2.5\n"


def write_depth(folder: Path, count: int = 2) -> Path:
    """A folder of depth images with stamps and camera file."""
    folder.mkdir()
    for index in range(count):
        write_image(folder / f"{index}.png", np.full((6, 8), 500 + index, np.uint16))
    (folder / "camera.toml").write_text(CAMERA)
    (folder / "timestamps.csv").write_text(
        "stamp_ns\n" + "".join(f"{k * 33_333_333}\n" for k in range(count))
    )
    return folder


def write_grey(folder: Path, count: int = 2) -> Path:
    """A folder of grey images of one camera."""
    folder.mkdir()
    for index in range(count):
        write_image(folder / f"{index}.png", np.full((48, 64), 100 + index, np.uint8))
    (folder / "camera.toml").write_text("fx = 60.0\nfy = 60.0\ncx = 31.5\ncy = 23.5\n")
    (folder / "timestamps.csv").write_text(
        "stamp_ns\n" + "".join(f"{k * 33_333_333}\n" for k in range(count))
    )
    return folder


def write_image(path: Path, image: np.ndarray) -> None:
    """As ``cv2.imwrite``, which a name that is not UTF-8 is too much for."""
    path.write_bytes(cv2.imencode(path.suffix, image)[1].tobytes())


def write_stamps(folder: Path, count: int) -> None:
    lines = ["stamp_ns", *(str(index * 33_333_333) for index in range(count))]
    (folder / "timestamps.csv").write_text("\n".join(lines))


def write_hand_result(path: Path) -> Path:
    """A result with truth."""
    return write_result(path, 12)
