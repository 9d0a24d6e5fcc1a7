"""Convert the head-mounted recordings of Oberweger et al. (CVPR 2016) with annotated joints to MCAP.

A folder has depth images and ``joint.txt``: the number of frames, then one line per frame with the name of
the image and u, v (pixels) and z (mm) of 21 joints. These are the wrist, then index, middle, ring, little
finger and thumb, each from the palm to the tip. The annotation is written as CSV for ``posetrack convert
--truth``.
"""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.cli.main import run as posetrack
from posetrack_cli.errors import PosetrackError, RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.model.anatomy import JOINT_NAMES
from posetrack_cli.recording.stamps import stamps_at_rate
from posetrack_cli.results.export.table import point_columns

CAMERA = Camera(width=320, height=240, fx=224.5, fy=230.5, cx=160.0, cy=120.0)  # Creative Senz3D
MISSING = 32001
RATE_HZ = 30.0
_FINGERS = ("index", "middle", "ring", "little")
# The joints in the file's order
ANNOTATED: tuple[str, ...] = (
    "wrist",
    *(f"{finger}_{joint}" for finger in _FINGERS for joint in ("mcp", "pip", "dip", "tip")),
    *(f"thumb_{joint}" for joint in ("cmc", "mcp", "ip", "tip")),
)


def convert(folder: Path, out: Path) -> Path:
    """Convert a recording to the MCAP file ``out``, with its joints on ``/truth/hand/points``."""
    if posetrack([*conversion(folder, out.parent), "-o", str(out), "--overwrite"]):
        raise PosetrackError("conversion failed", where=folder)
    return out


def conversion(folder: Path, work: Path) -> tuple[str, ...]:
    """Return the arguments of ``posetrack`` that convert a recording, without the output.

    Args:
        folder: folder of the recording.
        work: folder for the camera file and the ground truth.
    """
    camera, truth = (work / f"{folder.name}{ending}" for ending in (".camera.toml", ".csv"))
    images = sorted(folder.glob("*.png"))
    if not images:
        raise RecordingError("no images", where=folder)
    camera.write_text(camera_toml(images[0]), encoding="utf-8")
    write_truth(truth, [image.name for image in images], read_annotation(folder / "joint.txt"))
    return ("convert", str(folder), "--camera", str(camera), "--fps", f"{RATE_HZ:g}", "--truth", str(truth))


def camera_toml(image: Path) -> str:
    """Return the camera file of a folder; images with an empty last column are cropped."""
    stored = cv2.imread(str(image), cv2.IMREAD_UNCHANGED)
    if stored is None:
        raise RecordingError("image cannot be read", where=image)
    values = {name: f"{getattr(CAMERA, name)}" for name in ("fx", "fy", "cx", "cy")}
    values["missing"] = str(MISSING)
    if stored.shape[:2] != (CAMERA.height, CAMERA.width):
        values["crop"] = f"[0, 0, {CAMERA.width}, {CAMERA.height}]"
    return "".join(f"{name} = {value}\n" for name, value in values.items())


def read_annotation(path: Path) -> dict[str, FloatArray]:
    """Return the annotated joints (21, 3), mm, camera axes, in the order of ``JOINT_NAMES``, by image."""
    lines = path.read_text(encoding="utf-8").split("\n")
    order = [ANNOTATED.index(name) for name in JOINT_NAMES]
    found: dict[str, FloatArray] = {}
    for number, line in enumerate(lines[1:], 2):
        name, *cells = line.split() or [""]
        if not name:
            continue
        if len(cells) != 3 * len(ANNOTATED):
            expected = f"{3 * len(ANNOTATED)} numbers"
            raise RecordingError(
                "unexpected number of joints", where=f"{path}:{number}", found=len(cells), expected=expected
            )
        found[Path(name).name] = unprojected(np.array(cells, dtype=np.float64).reshape(-1, 3))[order]
    if len(found) != int(lines[0]):
        raise RecordingError("wrong number of frames", where=path, found=len(found), expected=lines[0])
    return found


def unprojected(joints: FloatArray) -> FloatArray:
    """Return x, y, z, mm, camera axes, of u, v, z (..., 3): x = (u - cx) z / fx, y likewise."""
    u, v, z = np.moveaxis(joints, -1, 0)
    return np.stack([(u - CAMERA.cx) * z / CAMERA.fx, (v - CAMERA.cy) * z / CAMERA.fy, z], axis=-1)


def write_truth(path: Path, images: list[str], annotation: dict[str, FloatArray]) -> None:
    """Write the joints as CSV; an image without annotation has no row."""
    stamps = stamps_at_rate(len(images), RATE_HZ)
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["stamp_ns", *point_columns(JOINT_NAMES)])
        for name, stamp_ns in zip(images, stamps, strict=True):
            if name in annotation:
                writer.writerow([stamp_ns, *annotation[name].ravel().tolist()])
