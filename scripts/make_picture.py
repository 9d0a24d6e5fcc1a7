"""Makes the README's picture: observed depth above, the estimate drawn into it below.

Usage: .venv/bin/python scripts/make_picture.py RECORDING.mcap RESULT.mcap OUT.png
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np

from posetrack_cli.hand.anatomy import make_anatomy
from posetrack_cli.hand.kinematics import skinning_transforms
from posetrack_cli.hand.mesh import hand_mesh
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.rendering.context import open_context
from posetrack_cli.rendering.tiled import TiledDepthRenderer
from posetrack_cli.rendering.window import Window
from posetrack_cli.results import load_arrays

COLUMNS = 6
NEAR_MM, FAR_MM = 480.0, 1150.0
CROP = (slice(30, 370), slice(120, 400))


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.argument("result", type=click.Path(path_type=Path))
@click.argument("out", type=click.Path(path_type=Path))
def main(recording: Path, result: Path, out: Path) -> None:
    """Draw some frames of a result over its recording."""
    opened, arrays = open_recording(recording), load_arrays(result)
    camera, anatomy = opened.cameras[0], make_anatomy()
    renderer = TiledDepthRenderer(
        open_context(), hand_mesh(anatomy, "fine"), (camera.width, camera.height), 1
    )
    rows = np.linspace(5, len(arrays["frame_index"]) - 1, COLUMNS).astype(int)
    wanted = {int(arrays["frame_index"][row]): row for row in rows}
    columns = []
    for frame in opened.frames():
        if frame.index in wanted:
            pose = pose_of(arrays, wanted[frame.index])
            drawn = renderer.depth(skinning_transforms(anatomy, pose[None]), camera, Window.whole(camera))[0]
            columns.append(column(frame.depth, drawn))
    cv2.imwrite(str(out), np.hstack(columns), [cv2.IMWRITE_PNG_COMPRESSION, 9])


def pose_of(arrays: dict[str, Any], row: int) -> Any:
    """One estimate as a pose (22,)."""
    return np.concatenate([arrays[name][row] for name in ("position", "quaternion", "shape")])


def column(observed: Any, drawn: Any) -> Any:
    """Observed depth in false colour above; below, dimmed, with the shaded estimate in it."""
    above = false_colour(observed)
    below = above // 4
    below[drawn > 0] = shaded(drawn)[drawn > 0]
    return np.vstack([above[CROP], below[CROP]])


def false_colour(depth: Any) -> Any:
    """Near is red, far is blue, no reading is black."""
    value = np.clip(255.0 * (FAR_MM - depth) / (FAR_MM - NEAR_MM), 0.0, 255.0).astype(np.uint8)
    return cv2.applyColorMap(value, cv2.COLORMAP_TURBO) * (depth > 0)[..., None].astype(np.uint8)


def shaded(depth: Any) -> Any:
    """A depth image lit from the upper left."""
    down, right = np.gradient(np.where(depth > 0, depth, np.nan))
    light = np.nan_to_num(0.75 - 0.25 * np.clip(down + right, -2.0, 2.0), nan=0.5)
    return (np.clip(light, 0.15, 1.0)[..., None] * np.array([150, 200, 235])).astype(np.uint8)


if __name__ == "__main__":
    main()
