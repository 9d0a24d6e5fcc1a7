"""The paper's figures 6, 7 and 10, and one of the study: PNG files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from posetrack_cli.evaluation.comparing.paired import Paired
from posetrack_cli.hand.anatomy import ANGLE_NAMES
from posetrack_cli.results import load_arrays

mpl.use("agg")

import matplotlib.pyplot as plt

TRUTH = "/truth/hand/estimate"
COLOURS = {"truth": "#222222", "pf": "#0072b2", "rbpf": "#d55e00"}  # told apart by the colour-blind, too
NAMES = {"truth": "truth", "pf": "PF", "rbpf": "RBPF"}
STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "legend.frameon": False,
    "savefig.dpi": 150,
}


@dataclass(frozen=True)
class Component:
    """One component of the pose over time, as an axis shows it."""

    label: str
    field: str
    column: int
    factor: float = 1.0

    def of(self, arrays: Mapping[str, Any]) -> Any:
        """Its values (N,)."""
        return self.factor * arrays[self.field][:, self.column]


WRIST_X = Component("wrist x, mm", "position", 0)
WRIST_Y = Component("wrist y, mm", "position", 1)
MIDDLE_BEND = Component(
    "middle finger, joint 2, deg", "shape", ANGLE_NAMES.index("middle_pip_flexion"), 180.0 / np.pi
)


def trajectories(path: Path, rows: Mapping[str, Mapping[str, Path]], components: Sequence[Component]) -> None:
    """Truth against PF and RBPF: a row of panels per configuration, a column per component.

    Args:
        path: PNG to write.
        rows: per row its title, and the results of ``pf`` and ``rbpf``.
        components: left to right, as in figures 6 and 7.
    """
    with plt.rc_context(STYLE):
        figure, panels = plt.subplots(
            len(rows), len(components), figsize=(4.6 * len(components), 2.6 * len(rows)), squeeze=False
        )
        for line, (title, results) in zip(panels, rows.items(), strict=True):
            for panel, component in zip(line, components, strict=True):
                _trajectory(panel, results, component)
                panel.set_title(title, loc="left", fontsize=9)
        panels[0][0].legend(ncols=3, fontsize=8)
        save(figure, path)


def _trajectory(panel: Any, results: Mapping[str, Path], component: Component) -> None:
    truth = load_arrays(next(iter(results.values())), TRUTH)
    tracks = {"truth": truth} | {kind: load_arrays(path) for kind, path in results.items()}
    start = int(truth["stamp_ns"][0])
    for kind, arrays in tracks.items():
        seconds = (arrays["stamp_ns"] - start) * 1e-9
        width = 1.8 if kind == "truth" else 1.1
        panel.plot(seconds, component.of(arrays), color=COLOURS[kind], label=NAMES[kind], lw=width)
    panel.set_xlabel("time, s")
    panel.set_ylabel(component.label)


def times(path: Path, particles: Sequence[int], milliseconds: Mapping[str, Sequence[float]]) -> None:
    """Figure 10: time per frame against the number of particles, logarithmic both."""
    with plt.rc_context(STYLE):
        figure, panel = plt.subplots(figsize=(4.6, 3.2))
        for kind, values in milliseconds.items():
            panel.loglog(particles, values, "o-", color=COLOURS[kind], label=NAMES[kind], lw=1.2, ms=4)
        panel.axhline(1000.0 / 30.0, color="#888888", lw=0.8, ls="--")
        at = (particles[-1], 1000.0 / 30.0)
        panel.annotate("sensor interval, 33 ms", at, (0, 3), textcoords="offset points", ha="right")
        panel.set_xticks(particles, [str(n) for n in particles])
        panel.minorticks_off()
        panel.set_xlabel("particles")
        panel.set_ylabel("time per frame, ms")
        panel.legend()
        save(figure, path)


def differences(
    path: Path, title: str, unit: str, linear_to: float, compared: Mapping[str, tuple[Any, Paired]]
) -> None:
    """The study: every recording's difference, and the mean with its 95 % interval, a row per condition.

    Args:
        path: PNG to write.
        title: what is subtracted from what.
        unit: of the differences.
        linear_to: up to here the axis is linear, logarithmic beyond.
        compared: per condition the paired differences (n,) and what they say together.
    """
    with plt.rc_context(STYLE | {"axes.grid.axis": "x"}):
        figure, panel = plt.subplots(figsize=(6.4, 0.36 * len(compared) + 1.1))
        for row, (values, summary) in enumerate(compared.values()):
            spread = row + 0.2 * np.linspace(-1.0, 1.0, len(values))
            panel.plot(values, spread, "o", color="#9ecae1", ms=3.5, mew=0)
            panel.plot([summary.low, summary.high], [row, row], color="#08519c", lw=2.5)
            panel.plot(summary.difference, row, "|", color="#08306b", ms=11, mew=2)
        panel.axvline(0.0, color="#444444", lw=0.8)
        panel.set_xscale("symlog", linthresh=linear_to, linscale=1.5)  # a lost hand is far off, most are not
        panel.xaxis.set_major_formatter("{x:g}")
        panel.set_yticks(range(len(compared)), list(compared))
        panel.invert_yaxis()
        panel.set_xlabel(f"difference, {unit}")
        panel.set_title(title, loc="left", fontsize=9)
        save(figure, path)


def save(figure: Any, path: Path) -> None:
    """Write a figure as PNG; the same figure gives the same bytes."""
    figure.tight_layout()
    figure.savefig(path, metadata={"Software": None})
    plt.close(figure)
