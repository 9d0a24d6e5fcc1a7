"""Two cameras on strangers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from reproduction.head_strangers.measuring import Measured
from reproduction.head_strangers.mono import judge_honesty, judge_most, judged_people, people_table, rows_of
from reproduction.head_strangers.options import Options
from reproduction.heads_data import reading_arguments
from reproduction.one_camera.population import TRACKED
from reproduction.running import Targets
from reproduction.steps import Chain, Step

MEDIAN = {"x_mm": 0.25, "y_mm": 0.25, "z_mm": 0.5, "roll_deg": 0.3, "pitch_deg": 0.6, "yaw_deg": 0.6}


class Stereo:
    """Both cameras, two passes."""

    name = "stereo"

    def chains(self, options: Options) -> list[Chain]:
        """One for each person."""
        return [_chain(options, folder) for folder in options.everybody]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A row per person, and what was asked for of the median one."""
        yield "## Two cameras, two passes"
        yield ""
        strangers = judged_people(options.strangers, self.name, measured)
        familiar = judged_people(options.familiar, self.name, measured)
        yield from people_table(strangers, familiar, self.name, measured)
        rows = list(rows_of(strangers).values())
        for name, limit in MEDIAN.items():
            values = [row[name] for row in rows if name in row]
            value = float(np.median(values)) if values else float("nan")
            judge_most(targets, f"stereo, {name.replace('_', ', ')}, median person", limit, value)
        judge_honesty({**strangers, **familiar}, self.name, measured, targets, "stereo: ")
        found, asked = len(rows), len(options.strangers)
        targets.add(
            "stereo: tracked, not refused", f"{asked} of {asked}", f"{found} of {asked}", found == asked
        )


def _chain(options: Options, folder: Path) -> Chain:
    reading, name = reading_arguments(folder, options.output / "recordings"), f"{folder.name}-stereo"
    arguments = ("head", "stereo", *reading, "--passes", "2", "--timings")
    return Chain(name, TRACKED, (Step(f"runs/{name}.mcap", arguments),))
