"""Frames per second of each configuration, one run at a time, on all cores."""

from __future__ import annotations

from collections.abc import Iterator

from reproduction.accuracy.measuring import Measured, Row
from reproduction.accuracy.options import AVERAGE, NO_MESH, Options, synthetic
from reproduction.accuracy.tasks import Task
from reproduction.running import Targets, table

CONFIGURATIONS = ("hand", "hand-fast", "hand-pso", "hand-paper")
LEAST_HZ = {"hand": 20.0, "hand-fast": 40.0}


class Speed:
    """Times of one recording; they depend on the machine, and on nothing else running there."""

    name = "speed"

    def tasks(self, options: Options) -> list[Task]:
        """One recording; the study runs it alone, before all others."""
        made = synthetic(options, "C", 1.0, options.first_seed)
        entrants = {name: ("--config", name, "--timings", *AVERAGE, *NO_MESH) for name in CONFIGURATIONS}
        return [Task(f"speed-{options.first_seed}-{options.frames}", made, entrants)]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A row per configuration."""
        yield "## Speed"
        yield ""
        yield (
            f"Motion C, speed 1, seed {options.first_seed}, {options.frames} frames, one run at a time "
            "with all cores; median time of a frame, compilation and file writing left out."
        )
        yield ""
        rows, taken = [], {}
        for name in CONFIGURATIONS:
            figures = [measured.figures(task, Row(name)) or {} for task in self.tasks(options)]
            taken[name] = figures[0].get("ms", float("nan"))
            hertz, spent = 1e3 / taken[name], figures[0].get("evaluations", float("nan"))
            rows.append([f"`{name}`", f"{taken[name]:.1f}", f"{hertz:.1f}", f"{spent:.0f}"])
            if name in LEAST_HZ:
                least = LEAST_HZ[name]
                reached = hertz >= least if hertz == hertz else None
                targets.add(f"`{name}`: frames/s", f">= {least:g}", f"{hertz:.1f}", reached)
        yield from table(("configuration", "ms per frame", "frames/s", "evaluations per frame"), rows)
        ratio = taken["hand"] / taken["hand-pso"]
        reached = ratio <= 0.1 if ratio == ratio else None
        targets.add("time of a frame, of PSO's", "<= 0.1", f"{ratio:.3f}", reached)
