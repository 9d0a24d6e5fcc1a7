"""The papers' figures as PNG files: poses over time, time per frame, paired differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np

from posetrack_cli.evaluation.judging.comparing import Paired

mpl.use("agg")

import matplotlib.pyplot as plt

COLOURS = ("#222222", "#0072b2", "#d55e00", "#009e73", "#e69f00")  # distinct for the colour-blind
STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "legend.frameon": False,
    "savefig.dpi": 150,
}


class Panel(NamedTuple):
    """One panel of curves."""

    label: str
    curves: Mapping[str, tuple[Any, Any]]
    title: str = ""


def over_time(
    path: Path, panels: Sequence[Sequence[Panel]], x_label: str, marks: Sequence[float] = ()
) -> None:
    """Plot rows of panels that share their horizontal axis."""
    names = list(dict.fromkeys(name for row in panels for panel in row for name in panel.curves))
    with plt.rc_context(STYLE):
        size = (5.0 * len(panels[0]), 1.7 * len(panels) + 0.6)
        figure, axes = plt.subplots(len(panels), len(panels[0]), figsize=size, sharex=True, squeeze=False)
        for axis, panel in zip(axes.flat, (panel for row in panels for panel in row), strict=True):
            for name, (x, y) in panel.curves.items():
                place = names.index(name)
                axis.plot(x, y, color=COLOURS[place], lw=1.8 if place == 0 else 1.0, label=name)
            axis.set_ylabel(panel.label)
            axis.set_title(panel.title, loc="left", fontsize=9)
            for mark in marks:
                axis.axvline(mark, color="#888888", lw=0.7, ls="--")
        for axis in axes[-1]:
            axis.set_xlabel(x_label)
        axes[0][0].legend(ncols=len(names), fontsize=8)
        _save(figure, path)


def times(path: Path, particles: Sequence[int], milliseconds: Mapping[str, Sequence[float]]) -> None:
    """Plot the time per frame against the number of particles, both logarithmic."""
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(4.6, 3.2))
        for (name, values), colour in zip(milliseconds.items(), COLOURS[1:], strict=False):
            axis.loglog(particles, values, "o-", color=colour, label=name, lw=1.2, ms=4)
        axis.axhline(1000.0 / 30.0, color="#888888", lw=0.8, ls="--", label="sensor interval, 33 ms")
        axis.set_xticks(particles, [str(n) for n in particles])
        axis.minorticks_off()
        axis.set_xlabel("particles")
        axis.set_ylabel("time per frame, ms")
        axis.legend()
        _save(figure, path)


def differences(
    path: Path, title: str, unit: str, linear_to: float, compared: Mapping[str, tuple[Any, Paired]]
) -> None:
    """Plot the difference of every recording (n,) and the mean with 95 % interval, one row per condition.

    The axis is linear up to ``linear_to`` and logarithmic beyond.
    """
    with plt.rc_context(STYLE | {"axes.grid.axis": "x"}):
        figure, axis = plt.subplots(figsize=(6.4, 0.36 * len(compared) + 1.1))
        for row, (values, said) in enumerate(compared.values()):
            spread = row + 0.2 * np.linspace(-1.0, 1.0, len(values))
            axis.plot(values, spread, "o", color="#9ecae1", ms=3.5, mew=0)
            axis.plot([said.low, said.high], [row, row], color="#08519c", lw=2.5)
            axis.plot(said.difference, row, "|", color="#08306b", ms=11, mew=2)
        axis.axvline(0.0, color="#444444", lw=0.8)
        axis.set_xscale("symlog", linthresh=linear_to, linscale=1.5)  # a lost hand is far off, most are not
        axis.xaxis.set_major_formatter("{x:g}")
        axis.set_yticks(range(len(compared)), list(compared))
        axis.invert_yaxis()
        axis.set_xlabel(f"difference, {unit}")
        axis.set_title(title, loc="left", fontsize=9)
        _save(figure, path)


def _save(figure: Any, path: Path) -> None:
    """Write a figure as PNG; the same figure gives the same bytes."""
    figure.tight_layout()
    figure.savefig(path, metadata={"Software": None})
    plt.close(figure)
