"""The study's figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.evaluation import Curve
from reproduction.figures import STYLE, save

COLOURS = ("#0072b2", "#009e73", "#56b4e9", "#d55e00", "#888888")  # told apart by the colour-blind, too
GOOD_OVERLAP, LEAST_OVERLAP = 0.8, 0.6


def errors_by_seed(path: Path, panels: Mapping[str, Mapping[str, FloatArray]]) -> bool:
    """Draw every recording's mean error, a panel per condition, a row per way to track; False for no data."""
    if not any(len(values) for rows in panels.values() for values in rows.values()):
        return False
    with plt.rc_context(STYLE | {"axes.grid.axis": "x"}):
        figure, axes = plt.subplots(
            1, len(panels), figsize=(4.2 * len(panels), 2.6), sharey=True, squeeze=False
        )
        for axis, (title, rows) in zip(axes[0], panels.items(), strict=True):
            for place, (values, colour) in enumerate(zip(rows.values(), COLOURS, strict=False)):
                spread = place + 0.25 * np.linspace(-1.0, 1.0, len(values))
                axis.plot(values, spread, "o", color=colour, ms=4, mew=0)
                if len(values):
                    axis.plot([values.mean()] * 2, [place - 0.35, place + 0.35], color="#222222", lw=1.2)
            axis.set_xscale("log")
            axis.xaxis.set_major_formatter("{x:g}")
            axis.set_yticks(range(len(rows)), list(rows))
            axis.set_xlabel("mean joint error of a recording, mm")
            axis.set_title(title, loc="left", fontsize=9)
        axes[0][0].invert_yaxis()
        save(figure, path)
    return True


def curves(path: Path, found: Mapping[str, Curve], limit_mm: float = 80.0) -> None:
    """Draw the share of frames whose largest (whole) and mean (dashed) joint error is below D."""
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(5.2, 3.2))
        for (name, curve), colour in zip(found.items(), COLOURS, strict=False):
            axis.plot(curve.thresholds_mm, 100 * curve.share, color=colour, label=f"{name}, largest")
            axis.plot(curve.thresholds_mm, 100 * curve.mean_share, "--", color=colour, label=f"{name}, mean")
        axis.set_xlim(0.0, limit_mm)
        axis.set_ylim(0.0, 102.0)
        axis.set_xlabel("D, mm")
        axis.set_ylabel("frames with joint error below D, %")
        axis.legend(fontsize=8)
        save(figure, path)


def overlap(path: Path, seconds: FloatArray, values: FloatArray) -> None:
    """Draw the overlap of rendered and observed hand over time."""
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(7.0, 2.4))
        axis.plot(seconds, values, color=COLOURS[0], lw=1.2)
        for level in (GOOD_OVERLAP, LEAST_OVERLAP):
            axis.axhline(level, color="#888888", lw=0.8, ls="--")
        axis.set_ylim(0.0, 1.02)
        axis.set_xlabel("time, s")
        axis.set_ylabel("region overlap")
        save(figure, path)
