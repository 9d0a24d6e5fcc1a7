"""Synthetic recordings of the tracker's own hand with all that a Kinect sees, automatic start."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.comparing.paired import paired
from posetrack_cli.results.tracks import SMOOTHED
from reproduction.accuracy import pictures
from reproduction.accuracy.measuring import Measured, Row, mean_and_sd, mean_of, number
from reproduction.accuracy.options import AVERAGE, NO_MESH, Options, seeds, synthetic
from reproduction.accuracy.tasks import Task
from reproduction.running import Targets, table

SPEEDS = (1.0, 2.0)
MOST_MM = {1.0: 2.0, 2.0: 3.0}
HAND, SMOOTH = Row("hand", title="`hand` (default)"), Row("hand", SMOOTHED, "`hand --smooth`, smoothed")
FAST, PAPER, PSO = (Row(name, title=f"`{name}`") for name in ("hand-fast", "hand-paper", "hand-pso"))
ROWS = (HAND, SMOOTH, FAST, PSO, PAPER)
ENTRANTS = {
    "hand": ("--config", "hand", "--smooth", *AVERAGE, *NO_MESH),
    "hand-fast": ("--config", "hand-fast", *AVERAGE, *NO_MESH),
    "hand-pso": ("--config", "hand-pso", *AVERAGE, *NO_MESH),
    "hand-paper": ("--config", "hand-paper", *AVERAGE, *NO_MESH),
}


class OwnModel:
    """Accuracy, intervals, smoothing and the comparison with PSO."""

    name = "own"

    def tasks(self, options: Options) -> list[Task]:
        """Both speeds, every seed."""
        return [task for speed in SPEEDS for task in tasks_at(options, speed)]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """Tables per speed, then smoothing and PSO."""
        yield "## Own model, full Kinect effects, automatic start"
        yield ""
        yield (
            "Motion C with noise, edges, background, body, forearm, dropped and late frames; "
            f"{options.seeds} recordings of {options.frames} frames per speed. Errors are of the 21 joints "
            "over all frames, lost ones included: mean ± standard deviation over recordings; worst: the "
            "largest mean of a recording; p95: mean over recordings of each one's 95th percentile. Astray: "
            "frames whose mean joint error is 20 mm or more, whatever their status. Inside 90 %: share of "
            "the 21 pose entries within their stated interval. Evaluations: poses rendered per frame."
        )
        yield ""
        for speed in SPEEDS:
            tasks = tasks_at(options, speed)
            yield f"### Speed {speed:g}"
            yield ""
            yield from accuracy_table(tasks, measured, ROWS)
            _judge(tasks, speed, measured, targets)
        picture = options.output / "own-model.png"
        if pictures.errors_by_seed(picture, _by_speed(options, measured)):
            yield f"![Mean joint error of every recording]({picture.name})"
            yield ""
        yield from _smoothing(options, measured, targets)
        yield from _against_pso(options, measured, targets)


def tasks_at(options: Options, speed: float) -> list[Task]:
    """The recordings of a speed."""
    return [
        Task(f"C-{speed:g}x-{seed}-{options.frames}", synthetic(options, "C", speed, seed), ENTRANTS)
        for seed in seeds(options)
    ]


def accuracy_table(tasks: Sequence[Task], measured: Measured, rows: Sequence[Row]) -> Iterator[str]:
    """A row for each way to track."""
    header = ("", "n", "mean error, mm", "worst", "p95, mm", "lost", "astray", "inside 90 %", "evaluations")
    yield from table(header, (_cells(tasks, measured, row) for row in rows))


def _cells(tasks: Sequence[Task], measured: Measured, row: Row) -> list[str]:
    def values(name: str) -> FloatArray:
        return measured.values(tasks, row, name)

    errors = values("error_mm")
    return [
        row.title or row.name,
        str(len(errors)),
        mean_and_sd(errors),
        number(float(errors.max())) if len(errors) else "-",
        mean_of(values("p95_mm")),
        mean_of(values("lost"), 2, percent=True),
        mean_of(values("astray"), 2, percent=True),
        mean_of(values("inside_90")),
        mean_of(values("evaluations"), 0),
    ]


def _judge(tasks: Sequence[Task], speed: float, measured: Measured, targets: Targets) -> None:
    """The default configuration against what was asked for."""
    checks = (
        ("error_mm", "mean joint error, mm", f"<= {MOST_MM[speed]:g}", 0.0, MOST_MM[speed]),
        ("p95_mm", "95th percentile of the joint error, mm", "<= 6", 0.0, 6.0),
        ("lost", "lost frames, share", "<= 0.005", 0.0, 0.005),
        ("inside_90", "stated 90 % intervals hold, share", "0.80 to 0.97", 0.80, 0.97),
    )
    for name, what, asked, low, high in checks:
        values = measured.values(tasks, HAND, name)
        mean = float(values.mean()) if len(values) else float("nan")
        reached = low <= mean <= high if len(values) else None
        targets.add(f"speed {speed:g}: {what}", asked, f"{mean:.3f}", reached)


def _by_speed(options: Options, measured: Measured) -> dict[str, dict[str, FloatArray]]:
    return {
        f"speed {speed:g}": {
            row.title.replace("`", ""): measured.values(tasks_at(options, speed), row, "error_mm")
            for row in ROWS
        }
        for speed in SPEEDS
    }


def _smoothing(options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
    """How much smaller the smoothed track's error is, recording by recording."""
    yield "### Smoothed against filtered, the same runs"
    yield ""
    rows = []
    for speed in SPEEDS:
        pairs = measured.pairs(tasks_at(options, speed), (HAND, SMOOTH), "error_mm")
        said = paired(*pairs.T)
        gain = 1.0 - pairs[:, 1].mean() / pairs[:, 0].mean() if len(pairs) else float("nan")
        reached = bool(gain >= 0.2) if len(pairs) else None
        targets.add(
            f"speed {speed:g}: smoothing lowers the mean error", ">= 20 %", f"{100 * gain:.1f} %", reached
        )
        rows.append(_paired_cells(f"{speed:g}", pairs, f"{100 * gain:.1f} %", said.p_value))
    yield from table(
        ("speed", "n", "filtered, mm", "smoothed, mm", "lower by", "better on", "p (Wilcoxon)"), rows
    )


def _paired_cells(name: str, pairs: FloatArray, gain: str, p_value: float) -> list[str]:
    better = int((pairs[:, 1] < pairs[:, 0]).sum())
    first, second = (mean_and_sd(column) for column in pairs.T)
    return [name, str(len(pairs)), first, second, gain, f"{better} of {len(pairs)}", f"{p_value:.2g}"]


def _against_pso(options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
    """Recording by recording against the swarm at its published budget."""
    yield "### Against PSO at its published budget (64 x 25)"
    yield ""
    rows, every, ratios = [], [], []
    for speed in SPEEDS:
        tasks = tasks_at(options, speed)
        pairs = measured.pairs(tasks, (PSO, HAND), "error_mm")
        spent = measured.pairs(tasks, (PSO, HAND), "evaluations")
        ratio = spent[:, 1].mean() / spent[:, 0].mean() if len(spent) else float("nan")
        ratios.append(ratio)
        every.append(pairs)
        rows.append(_paired_cells(f"{speed:g}", pairs, f"{ratio:.3f}", paired(*pairs.T).p_value))
    yield from table(
        ("speed", "n", "PSO, mm", "hand, mm", "evaluations, ratio", "better on", "p (Wilcoxon)"), rows
    )
    pairs = np.concatenate(every)
    better, known = int((pairs[:, 1] < pairs[:, 0]).sum()), len(pairs) > 0
    said = f"{better} of {len(pairs)}"
    targets.add("better than PSO, recordings", "all", said, better == len(pairs) if known else None)
    worst = float(np.max(ratios))
    reached = worst <= 0.1 if np.isfinite(worst) else None
    targets.add("poses evaluated, of PSO's", "<= 0.1", f"{worst:.3f}", reached)
