"""Does the marginalised velocity pay? RBPF against PF, same budget, guided and plain."""

from __future__ import annotations

from collections.abc import Iterator

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.comparing.paired import paired
from reproduction.accuracy.measuring import PAIR_COLUMNS, Measured, Row, mean_and_sd, pair_cells
from reproduction.accuracy.options import AVERAGE, NO_MESH, Options, seeds, synthetic
from reproduction.accuracy.tasks import RECORDING, Task
from reproduction.running import Targets, table

CONDITIONS = (("B", 1.0), ("B", 2.0), ("C", 1.0), ("C", 2.0))
PROPOSALS = {"guided": "by the local fits", "marginal": "from the motion alone"}
FROM_TRUTH = ("--init", RECORDING)
"""Both filters begin at the true pose: they are compared, not their starts; motion B may begin anywhere."""
LEVEL = 0.01


class Filters:
    """Paired over recordings, per motion, speed and proposal."""

    name = "filters"

    def tasks(self, options: Options) -> list[Task]:
        """Every condition and seed, both filters with both proposals."""
        return [task for motion, speed in CONDITIONS for task in tasks_of(options, motion, speed)]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A row per condition and proposal."""
        yield "## RBPF against PF, same budget"
        yield ""
        yield (
            f"{options.seeds} recordings per row, {options.frames} frames, both filters on the same ones "
            "with the same seed, from the true pose, all else as in `hand`. B is a random walk of pose and "
            "velocity with a bare hand, C natural motion with all effects. Differences are RBPF - PF."
        )
        yield ""
        rows = []
        for proposal, drawn in PROPOSALS.items():
            pair = tuple(Row(f"{kind}-{proposal}") for kind in ("pf", "rbpf"))
            for motion, speed in CONDITIONS:
                pairs = measured.pairs(tasks_of(options, motion, speed), (pair[0], pair[1]), "error_mm")
                rows.append(_cells(f"{motion}, {speed:g}", drawn, pairs))
                if proposal == "guided":
                    _judge(f"{motion}, speed {speed:g}", pairs, targets)
        header = (
            "motion, speed",
            "particles drawn",
            "n",
            "PF, mm",
            "RBPF, mm",
            *PAIR_COLUMNS,
            "RBPF better on",
        )
        yield from table(header, rows)


def tasks_of(options: Options, motion: str, speed: float) -> list[Task]:
    """The recordings of a condition."""
    entrants = {
        f"{kind}-{proposal}": (
            "--config",
            "hand",
            "--filter",
            kind,
            *_proposal(proposal),
            *FROM_TRUTH,
            *AVERAGE,
            *NO_MESH,
        )
        for kind in ("pf", "rbpf")
        for proposal in PROPOSALS
    }
    return [
        Task(
            f"{motion}-{speed:g}x-{seed}-{options.frames}-filters",
            synthetic(options, motion, speed, seed),
            entrants,
        )
        for seed in seeds(options)
    ]


def _proposal(name: str) -> tuple[str, str]:
    return "--set", f"filter.proposal={name}"


def _cells(condition: str, drawn: str, pairs: FloatArray) -> list[str]:
    said = paired(*pairs.T)
    first, second = (mean_and_sd(column) for column in pairs.T)
    better = int((pairs[:, 1] < pairs[:, 0]).sum())
    return [condition, drawn, str(said.count), first, second, *pair_cells(said), f"{better}"]


def _judge(condition: str, pairs: FloatArray, targets: Targets) -> None:
    said = paired(*pairs.T)
    reached = said.p_value < LEVEL and said.difference < 0.0 if said.count else None
    measured = f"{said.difference:+.3f} mm, p = {said.p_value:.2g}"
    targets.add(f"{condition}: RBPF better than PF", "p < 0.01", measured, reached)
