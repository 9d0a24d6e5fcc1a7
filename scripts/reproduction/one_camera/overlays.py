"""The thesis's figure 4.10: estimates on the images, and both from another viewpoint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import pixels_from_points
from posetrack_cli.head.face.points import LINES
from posetrack_cli.recording.opening import open_recording
from reproduction.figures import STYLE, save
from reproduction.one_camera.figures import pose_columns
from reproduction.one_camera.measuring import Compared, in_head, pose_of

AXIS_MM = 60.0
MARGIN_MM = 75.0
AXES = ("#d62728", "#2ca02c", "#1f77b4")
"""Colours of x, y, z."""
SIDE = {"two cameras": "#d62728", "one camera": "#1f77b4"}
"""Red and blue plus signs as in the thesis."""
ROWS = 5


def draw(path: Path, recording: Path, one: Compared) -> None:
    """Draw figure 4.10: a row for each of a few frames that differ most.

    Args:
        path: PNG to write.
        recording: of both cameras; the first one's images are shown.
        one: one camera's result beside two cameras'.
    """
    rows = chosen_rows(one)
    numbers = _frame_numbers(one, rows)
    camera, images = _images(recording, numbers)
    tracks = {"two cameras": one.reference, "one camera": one.track}
    with plt.rc_context(STYLE | {"axes.grid": False}):
        figure, panels = plt.subplots(len(rows), 3, figsize=(9.0, 3.0 * len(rows)), squeeze=False)
        for line, row, number in zip(panels, rows, numbers, strict=True):
            for panel, (title, track) in zip(line, tracks.items(), strict=False):
                panel.imshow(images[number], cmap="gray", vmin=0, vmax=255)
                _overlay(panel, camera, track, row)
                _crop(panel, camera, one.reference, row)
                panel.set_title(f"{title}, frame {number}", loc="left", fontsize=9)
            _from_the_side(line[2], tracks, row)
        save(figure, path)


def chosen_rows(one: Compared) -> list[int]:
    """Rows of the greatest deformation in each half, the nearest, the farthest and the most turned head."""
    shape = in_head(one.reference)
    moved = np.linalg.norm(shape - np.median(shape, axis=0), axis=2).max(axis=1)
    columns = pose_columns(one.reference)
    z, yaw = columns[:, 2], np.abs(columns[:, 5] - np.median(columns[:, 5]))
    halves = [half for half in np.array_split(np.flatnonzero(one.tracked), 2) if half.size]
    found = [int(half[np.argmax(moved[half])]) for half in halves]
    tracked = np.flatnonzero(one.tracked)
    extremes = (np.argmin(z[tracked]), np.argmax(z[tracked]), np.argmax(yaw[tracked]))
    return sorted({*found, *(int(tracked[k]) for k in extremes)})[:ROWS]


def _frame_numbers(one: Compared, rows: Sequence[int]) -> list[int]:
    known = one.track.frame_index
    return [row if known is None else int(known[row]) for row in rows]


def _images(recording: Path, numbers: Sequence[int]) -> tuple[Camera, Mapping[int, ImageArray]]:
    """The first camera, and its images of some frames."""
    source = open_recording(recording, "grey")
    images: dict[int, ImageArray] = {}
    for frame in source.frames():
        if frame.index in numbers:
            image = frame.images[0]
            images[frame.index] = np.zeros(_size(source.cameras[0]), np.uint8) if image is None else image
        if len(images) == len(numbers):
            break
    return source.cameras[0], images


def _size(camera: Camera) -> tuple[int, int]:
    return camera.height, camera.width


def _overlay(panel: Any, camera: Camera, track: Track, row: int) -> None:
    """Points, lines between them and the axes of the head."""
    pixels = _pixels(camera, _points(track)[row])
    for a, b in LINES:
        panel.plot(*pixels[[a, b]].T, color="#ffdd00", lw=0.8)
    panel.plot(*pixels.T, "+", color="#ffdd00", ms=6, mew=1.2)
    position, quaternion = (values[row] for values in pose_of(track))
    tips = position + AXIS_MM * rotations.matrices_from_quaternions(quaternion).T
    start, *ends = _pixels(camera, np.vstack([position, tips]))
    for end, colour in zip(ends, AXES, strict=True):
        panel.plot([start[0], end[0]], [start[1], end[1]], color=colour, lw=1.8)


def _crop(panel: Any, camera: Camera, track: Track, row: int) -> None:
    """Show the head only."""
    points = _points(track)[row]
    low, high = points.min(axis=0) - MARGIN_MM, points.max(axis=0) + MARGIN_MM
    middle = points[:, 2].mean()
    corners = _pixels(camera, np.array([[low[0], low[1], middle], [high[0], high[1], middle]]))
    corners = np.clip(corners, 0.0, [camera.width - 1.0, camera.height - 1.0])
    panel.set_xlim(*corners[:, 0])
    panel.set_ylim(*corners[::-1, 1])
    panel.set_axis_off()


def _from_the_side(panel: Any, tracks: Mapping[str, Track], row: int) -> None:
    """Depth to the right, height upwards: what one camera cannot see."""
    for title, track in tracks.items():
        points = _points(track)[row]
        panel.plot(points[:, 2], -points[:, 1], "+", color=SIDE[title], ms=8, mew=1.6, label=title)
        position, quaternion = (values[row] for values in pose_of(track))
        tip = position + AXIS_MM * rotations.matrices_from_quaternions(quaternion)[:, 2]
        panel.plot([position[2], tip[2]], [-position[1], -tip[1]], color=SIDE[title], lw=1.2)
    panel.set_aspect("equal", adjustable="datalim")
    panel.margins(0.25)
    panel.tick_params(labelsize=7)
    panel.set_xlabel("depth, mm", fontsize=8)
    panel.legend(fontsize=7)


def _points(track: Track) -> Any:
    """Points that every track of a head has."""
    return track.points


def _pixels(camera: Camera, points: FloatArray) -> FloatArray:
    return pixels_from_points(camera, points)[0]
