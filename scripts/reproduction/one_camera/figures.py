"""The thesis's figures 4.11 to 4.14."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry.euler import head_roll_pitch_yaw
from reproduction.figures import STYLE, save
from reproduction.one_camera.measuring import Compared, pose_of
from reproduction.one_camera.tables import THESIS_POINTS_MM

LABELS = ("x, mm", "y, mm", "z, mm", "roll, deg", "pitch, deg", "yaw, deg")
COLOURS = {"two cameras": "#d62728", "A": "#0072b2", "B": "#009e73", "C": "#e69f00"}
WIDTHS = {"two cameras": 0.8, "A": 1.8, "B": 1.2, "C": 1.2}
"""Thin and thick as in the thesis."""


def pose_columns(track: Track) -> FloatArray:
    """Return x, y, z (mm), roll, pitch, yaw (deg), (N, 6), in camera axes."""
    position, quaternion = pose_of(track)
    angles: FloatArray = np.degrees(np.unwrap(head_roll_pitch_yaw(quaternion), axis=0))
    return np.hstack([position, angles])


def points_over_time(path: Path, one: Compared) -> None:
    """Figure 4.11: the mean error of the points in each frame, with and without constant offsets."""
    with plt.rc_context(STYLE):
        figure, panel = plt.subplots(figsize=(7.2, 3.0))
        lines = {
            "after one constant rigid movement": (one.points_mm, "#0072b2"),
            "after each point's constant offset, too": (one.shapes_mm, "#d55e00"),
        }
        for label, (errors, colour) in lines.items():
            mean = np.where(one.tracked, errors.mean(axis=1), np.nan)
            panel.plot(frames_of(one), mean, color=colour, lw=0.9, label=f"{label}: {np.nanmean(mean):.2f}")
        panel.axhline(THESIS_POINTS_MM, color="#888888", lw=0.8, ls="--")
        at = (frames_of(one)[-1], THESIS_POINTS_MM)
        panel.annotate(
            f"thesis, mean: {THESIS_POINTS_MM}",
            at,
            (0, 3),
            textcoords="offset points",
            ha="right",
            fontsize=8,
        )
        panel.set_ylim(0.0, None)
        panel.set_xlabel("frame")
        panel.set_ylabel("mean error of points, mm")
        panel.legend(fontsize=8)
        save(figure, path)


def poses_over_time(path: Path, compared: Mapping[str, Compared]) -> None:
    """Figures 4.12 to 4.14: the six components; beside them how far each is from two cameras.

    Args:
        path: PNG to write.
        compared: by experiment, the main one first; all with the same reference.
    """
    first = next(iter(compared.values()))
    tracks = {"two cameras": (frames_of(first), pose_columns(first.reference))}
    tracks |= {name: (frames_of(one), _while_tracked(one)) for name, one in compared.items()}
    order = [*compared, "two cameras"]  # the thin line above the thick ones
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(len(LABELS), 2, figsize=(11.0, 11.0), sharex=True)
        for row, label in enumerate(LABELS):
            value, error = panels[row]
            for name in order:
                frames, columns = tracks[name]
                value.plot(frames, columns[:, row], color=COLOURS[name], lw=WIDTHS[name], label=name)
            for name, one in compared.items():
                column = np.where(one.tracked, one.pose[:, row], np.nan)
                mean = f"{name}: {np.nanmean(column):.2f}"
                error.plot(frames_of(one), column, color=COLOURS[name], lw=0.7, label=mean)
            value.set_ylabel(label)
            error.set_ylabel(f"|error|: {label}")
            error.legend(ncols=len(compared), fontsize=7, loc="upper right")
            error.set_ylim(0.0, 1.3 * _highest([one.pose[one.tracked, row] for one in compared.values()]))
        for panel in panels[-1]:
            panel.set_xlabel("frame")
        panels[0, 0].legend(ncols=len(order), fontsize=8, loc="upper left", bbox_to_anchor=(0.0, 1.35))
        save(figure, path)


def frames_of(one: Compared) -> FloatArray:
    """Numbers (M,) of the frames."""
    known = one.track.frame_index
    return np.arange(one.frames, dtype=np.float64) if known is None else known.astype(np.float64)


def _while_tracked(one: Compared) -> FloatArray:
    """Pose columns (M, 6), NaN where the head is lost."""
    shown: FloatArray = np.where(one.tracked[:, None], pose_columns(one.track), np.nan)
    return shown


def _highest(columns: list[FloatArray]) -> float:
    """What an axis must reach: the greatest value, 1 where there is none."""
    return max((float(column.max()) for column in columns if column.size), default=1.0)
