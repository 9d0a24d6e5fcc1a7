"""Hands of other proportions: tracked as the average hand, and with the shape that a run finds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from posetrack_cli.evaluation.evaluate import evaluate
from posetrack_cli.evaluation.figures import figure_of
from posetrack_cli.hand.anatomy import JOINT_NAMES
from reproduction.accuracy.measuring import Measured, Row, mean_and_sd, mean_of, number
from reproduction.accuracy.options import AVERAGE, NO_MESH, Options, synthetic
from reproduction.accuracy.tasks import Task
from reproduction.running import Targets, table

MOST_MM = 5.0
TOLD, FITTED = Row("average", title="average hand"), Row("found", title="shape found (default)")
ENTRANTS = {
    "average": ("--config", "hand", *AVERAGE, *NO_MESH),
    "found": ("--config", "hand", *NO_MESH),
}


def _every_finger(option: str, factors: Sequence[float]) -> tuple[str, ...]:
    return (option, *(f"{factor:g}" for factor in factors))


HANDS: dict[str, tuple[str, ...]] = {
    "scale-0.85": ("--scale", "0.85"),
    "scale-1.15": ("--scale", "1.15"),
    "long-fingers": _every_finger("--finger-lengths", (1.1,) * 5),
    "short-fingers": _every_finger("--finger-lengths", (0.9,) * 5),
    "uneven-fingers": _every_finger("--finger-lengths", (0.9, 1.1, 0.95, 1.1, 0.9)),
    "thick-fingers": _every_finger("--finger-widths", (1.2,) * 5),
    "thin-fingers": _every_finger("--finger-widths", (0.85,) * 5),
    "random": ("--random-hand",),
}
"""By name the arguments of ``posetrack hand synth``."""


class OtherHands:
    """Error as the average hand and with the shape that is found, and the bias per joint."""

    name = "hands"

    def tasks(self, options: Options) -> list[Task]:
        """Every hand, some seeds each."""
        return [task for name, shape in hands(options).items() for task in tasks_of(options, name, shape)]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A table of hands, and one of the joints' biases."""
        yield "## Other hands, their shapes found in the recording itself"
        yield ""
        yield (
            f"Motion C, speed 1, all effects, forearm included; {options.hand_seeds} recordings of "
            f"{options.frames} frames per hand. The run finds the shape in the recording, without truth. "
            "Bias: mean length of the 21 joints' mean error vectors in the palm's axes."
        )
        yield ""
        rows, found = [], []
        for name, shape in hands(options).items():
            tasks = tasks_of(options, name, shape)
            rows.append([name, *(cell for row in (TOLD, FITTED) for cell in _cells(tasks, measured, row))])
            found += measured.values(tasks, FITTED, "error_mm").tolist()
        figures = ("error, mm", "lost", "bias, mm")
        yield from table(
            ("hand", *(f"{row.title}: {what}" for row in (TOLD, FITTED) for what in figures)), rows
        )
        mean = float(np.mean(found)) if found else float("nan")
        reached = mean <= MOST_MM if found else None
        targets.add("other hands, shape found: mean joint error, mm", "<= 5", f"{mean:.2f}", reached)
        yield from _biases(options, measured)


def hands(options: Options) -> dict[str, tuple[str, ...]]:
    """The hands of a study, that of its GLB file included."""
    mesh = {} if options.mesh is None else {"another-mesh": ("--hand-mesh", str(options.mesh))}
    return HANDS | mesh


def tasks_of(options: Options, name: str, shape: tuple[str, ...]) -> list[Task]:
    """The recordings of a hand."""
    return [
        Task(f"{name}-{seed}-{options.frames}", synthetic(options, "C", 1.0, seed, *shape), ENTRANTS)
        for seed in range(options.first_seed, options.first_seed + options.hand_seeds)
    ]


def _cells(tasks: Sequence[Task], measured: Measured, row: Row) -> list[str]:
    return [
        mean_and_sd(measured.values(tasks, row, "error_mm")),
        mean_of(measured.values(tasks, row, "lost"), 1, percent=True),
        mean_of(measured.values(tasks, row, "bias_mm")),
    ]


def _biases(options: Options, measured: Measured) -> Iterator[str]:
    """Mean over recordings of the joints' bias with the shape that was found, x y z, mm."""
    yield "Bias per joint with the shape found, x y z in the palm's axes (thumb, wrist, back), mm:"
    yield ""
    found = {
        name: _bias_of(tasks_of(options, name, shape), measured) for name, shape in hands(options).items()
    }
    known = {name: bias for name, bias in found.items() if bias is not None}
    rows = (
        [joint, *(" ".join(number(value, 1) for value in bias[place]) for bias in known.values())]
        for place, joint in enumerate(JOINT_NAMES)
    )
    yield from table(("joint", *known), rows)


def _bias_of(tasks: Sequence[Task], measured: Measured) -> np.ndarray | None:
    """(21, 3) mm, mean over the recordings; None without any."""
    paths = [path for task in tasks if (path := task.result(measured.folder, FITTED.entrant)).exists()]
    every = []
    for evaluation in map(evaluate, paths):
        every.append(
            [
                [figure_of(evaluation, f"joint_bias_{axis}_mm.{joint}").value for axis in "xyz"]
                for joint in JOINT_NAMES
            ]
        )
    return np.mean(np.array(every, dtype=np.float64), axis=0) if every else None
