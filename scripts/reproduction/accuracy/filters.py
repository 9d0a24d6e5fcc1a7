"""Does velocity help? RBPF against PF with the same budget, by speed, frame rate and proposal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.comparing.paired import paired
from posetrack_cli.hand.smoothing import SMOOTH_POSE, SMOOTH_VELOCITY
from reproduction.accuracy.measuring import PAIR_COLUMNS, Measured, Row, mean_and_sd, pair_cells
from reproduction.accuracy.options import AVERAGE, NO_MESH, Options, seeds, synthetic
from reproduction.accuracy.tasks import RECORDING, Task
from reproduction.running import Targets, table


class Condition(NamedTuple):
    """Motion, speed and frame rate of recordings."""

    motion: str
    speed: float
    fps: float = 30.0

    @property
    def name(self) -> str:
        """As tables call it."""
        return f"{self.motion}, {self.speed:g}, {self.fps:g} Hz"


CONDITIONS = (
    *(Condition(motion, speed) for motion in "BC" for speed in (1.0, 2.0)),
    Condition("C", 3.0),
    *(Condition("C", 1.0, fps) for fps in (10.0, 20.0, 60.0)),
)
PROPOSALS = {"guided": "by the local fits", "paper": "(51) as printed"}
SMOOTH = tuple(
    part
    for name, settings in (("pose", SMOOTH_POSE), ("velocity", SMOOTH_VELOCITY))
    for key, value in settings
    for part in ("--set", f"motion.{name}.{key}={value}")
)
"""The noise densities of the smoothed track: nearly all motion is velocity, and the filter's follows it."""
FILTERS = {"pf": ("pf", ()), "rbpf": ("rbpf", ()), "smooth": ("rbpf", SMOOTH)}
"""Filter and further arguments by entrant."""
FROM_TRUTH = ("--init", RECORDING)
"""Both filters begin at the true pose: they are compared, not their starts; motion B may begin anywhere."""
LEVEL = 0.01


class Filters:
    """Paired over recordings, per condition and proposal."""

    name = "filters"

    def tasks(self, options: Options) -> list[Task]:
        """Every condition and seed, all filters with both proposals."""
        return [task for condition in CONDITIONS for task in tasks_of(options, condition)]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A row per condition, proposal and RBPF."""
        yield "## RBPF against PF, same budget"
        yield ""
        yield (
            f"{options.seeds} recordings per row, {options.frames} frames, all filters on the same ones "
            "with the same seed, from the true pose, all else as in `hand`. B is a random walk of pose and "
            "velocity with a bare hand, C natural motion with all effects. Smooth: the RBPF with the noise "
            "densities of the smoothed track. Differences are RBPF - PF."
        )
        yield ""
        rows = []
        for proposal, drawn in PROPOSALS.items():
            for condition in CONDITIONS:
                for kind in ("rbpf", "smooth"):
                    pair = Row(f"pf-{proposal}"), Row(f"{kind}-{proposal}")
                    pairs = measured.pairs(tasks_of(options, condition), pair, "error_mm")
                    densities = "default" if kind == "rbpf" else "smooth"
                    rows.append(_cells(condition.name, drawn, densities, pairs))
                    if proposal == "guided" and kind == "rbpf":
                        _judge(condition.name, pairs, targets)
        header = (
            "motion, speed, frame rate",
            "particles drawn",
            "densities",
            "n",
            "PF, mm",
            "RBPF, mm",
            *PAIR_COLUMNS,
            "RBPF better on",
        )
        yield from table(header, rows)


def tasks_of(options: Options, condition: Condition) -> list[Task]:
    """The recordings of a condition."""
    motion, speed, fps = condition
    entrants = {
        f"{name}-{proposal}": (
            "--config",
            "hand",
            "--filter",
            kind,
            *_proposal(proposal),
            *densities,
            *FROM_TRUTH,
            *AVERAGE,
            *NO_MESH,
        )
        for name, (kind, densities) in FILTERS.items()
        for proposal in PROPOSALS
    }
    return [
        Task(
            f"{motion}-{speed:g}x-{fps:g}Hz-{seed}-{options.frames}-filters",
            synthetic(options, motion, speed, seed, "--fps", f"{fps:g}"),
            entrants,
        )
        for seed in seeds(options)
    ]


def _proposal(name: str) -> tuple[str, str]:
    return "--set", f"filter.proposal={name}"


def _cells(condition: str, drawn: str, densities: str, pairs: FloatArray) -> list[str]:
    said = paired(*pairs.T)
    first, second = (mean_and_sd(column) for column in pairs.T)
    better = int((pairs[:, 1] < pairs[:, 0]).sum())
    return [condition, drawn, densities, str(said.count), first, second, *pair_cells(said), f"{better}"]


def _judge(condition: str, pairs: FloatArray, targets: Targets) -> None:
    said = paired(*pairs.T)
    reached = said.p_value < LEVEL and said.difference < 0.0 if said.count else None
    measured = f"{said.difference:+.3f} mm, p = {said.p_value:.2g}"
    targets.add(f"{condition}: RBPF better than PF", "p < 0.01", measured, reached)
