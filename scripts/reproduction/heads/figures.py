"""The thesis's figure 3.10, with the truth, and how far each model is from it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry.euler import head_roll_pitch_yaw
from reproduction.figures import STYLE, save
from reproduction.heads.measuring import FOLLOWED, MOVING_MM, Course

LABELS = ("x, mm", "y, mm", "z, mm", "roll, deg", "pitch, deg", "yaw, deg")
COLOURS = {"truth": "#bbbbbb", "rigid": "#d55e00", "deformable": "#0072b2"}  # told apart by the colour-blind
WIDTHS = {"truth": 3.0, "rigid": 0.7, "deformable": 1.5}
"""Thin and thick as in the thesis, above the truth."""


def pose_columns(track: Track) -> FloatArray:
    """Return x, y, z (mm), roll, pitch, yaw (deg), (N, 6), in camera axes."""
    position, quaternion = _known(track.position), _known(track.quaternion)
    angles: FloatArray = np.degrees(np.unwrap(head_roll_pitch_yaw(quaternion), axis=0))
    return np.hstack([position, angles])


def poses_over_time(
    path: Path,
    tracks: Mapping[str, Track],
    courses: Mapping[str, Course],
    contribution: FloatArray,
    parts: tuple[int, int],
) -> None:
    """Draw figure 3.10: the six components and the contribution ratio; beside them the errors.

    Args:
        path: PNG to write.
        tracks: ``truth``, and of ``rigid`` and ``deformable`` the aligned estimates.
        courses: of ``rigid`` and ``deformable``.
        contribution: (N,) cumulative contribution ratio of the deformable model, NaN before it has learned.
        parts: first frame with a deformable model, first frame of rigid motion.
    """
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(7, 2, figsize=(11.0, 12.0), sharex=True)
        columns = {name: pose_columns(track) for name, track in tracks.items()}
        for row, label in enumerate(LABELS):
            _lines(panels[row, 0], {name: values[:, row] for name, values in columns.items()}, label)
            errors = {name: one.pose[:, row] for name, one in courses.items()}
            _lines(panels[row, 1], errors, f"error: {label}")
        _lines(panels[6, 0], {"deformable": contribution}, "contribution ratio")
        panels[6, 0].set_ylim(0.0, 1.05)
        _lines(panels[6, 1], {name: _moving(one) for name, one in courses.items()}, "moving points, mm")
        for panel in panels.flat:
            for frame in parts:
                panel.axvline(frame, color="#888888", lw=0.7, ls="--")
        for panel in panels[6]:
            panel.set_xlabel("frame")
        panels[0, 0].legend(ncols=3, fontsize=8, loc="upper left", bbox_to_anchor=(0.0, 1.35))
        save(figure, path)


def _lines(panel: Any, values: Mapping[str, FloatArray], label: str) -> None:
    for name, of_name in values.items():
        panel.plot(of_name, color=COLOURS[name], lw=WIDTHS[name], label=name)
    panel.set_ylabel(label)


def _moving(one: Course) -> FloatArray:
    """Mean error (M,) of the points that are away from their neutral places; NaN while none is."""
    moving = one.moved_mm[:, FOLLOWED] > MOVING_MM
    count = moving.sum(axis=1)
    total = np.where(moving, one.points_mm[:, FOLLOWED], 0.0).sum(axis=1)
    mean: FloatArray = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return mean


def _known(array: FloatArray | None) -> Any:
    """An array that every track of a head has."""
    return array
