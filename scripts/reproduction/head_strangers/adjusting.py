"""The thesis's question on strangers: when the person is adjusted, and in how many passes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from posetrack_cli.evaluation.metrics.head_metrics import HEAD_POSE
from reproduction.accuracy.measuring import number
from reproduction.head_strangers.measuring import Judged, Measured
from reproduction.head_strangers.mono import judged_people, mono_chain, rows_of
from reproduction.head_strangers.options import Options
from reproduction.one_camera.comparing import METRICS, PAIRED_HEADER, paired_cells
from reproduction.one_camera.entrants import FIRST, SECOND, Entrant, adjusted
from reproduction.one_camera.tables import AXES
from reproduction.running import Targets, table
from reproduction.steps import Chain

PIECEMEAL = ("--set", "adjustment.whole=false")
ENTRANTS = (
    Entrant("never-1", "never, one pass", (*adjusted("never"), *FIRST)),
    Entrant("never-2", "never, two passes", (*adjusted("never"), *SECOND)),
    Entrant("start-1", "at the start, one pass", (*adjusted("start"), *FIRST)),
    Entrant("start-2", "at the start, two passes", (*adjusted("start"), *SECOND)),
    Entrant("always-1", "always, one pass", (*adjusted("always"), *FIRST)),
    Entrant("always-2", "always, two passes", (*adjusted("always"), *SECOND, *PIECEMEAL)),
    Entrant("whole", "always, then over the whole recording (default)", SECOND),
)
"""Each with what was learned without the person, where that is given."""
PAIRS = (
    ("never-1", "start-1"),
    ("start-1", "always-1"),
    ("never-2", "start-2"),
    ("start-2", "always-2"),
    ("always-1", "always-2"),
    ("always-2", "whole"),
    ("start-2", "whole"),
    ("always-1", "whole"),
)
"""The second is expected to be better."""
COMPARED = {name: METRICS[name] for name in ("position_mm", "z_mm", "rotation_deg", "pitch_deg", "yaw_deg")}


class Adjusting:
    """The left camera alone, the person adjusted now or then."""

    name = "adjusting"

    def chains(self, options: Options) -> list[Chain]:
        """One for each stranger and way."""
        return [
            mono_chain(
                options,
                folder,
                f"{folder.name}-{entrant.name}",
                (*options.learned_without(folder), *entrant.arguments),
            )
            for folder in options.strangers
            for entrant in ENTRANTS
        ]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """Medians over the people, then pairs."""
        yield "## When the person is adjusted, and in how many passes"
        yield ""
        yield (
            "Medians over the people of mean absolute errors after one constant rigid offset; right depth "
            "factor: its mean distance from 1."
        )
        yield ""
        people = {way.name: judged_people(options.strangers, way.name, measured) for way in ENTRANTS}
        rows = {name: rows_of(found) for name, found in people.items()}
        cells = []
        for entrant in ENTRANTS:
            figures = list(rows[entrant.name].values())
            if figures:
                medians = {name: float(np.median([one[name] for one in figures])) for name in HEAD_POSE}
                factor = float(np.mean([abs(one["factor"] - 1.0) for one in figures]))
                measured.note(self.name, entrant.name, medians | {"factor": factor})
                cells.append([entrant.title, *map(number, medians.values()), number(factor, 3)])
        yield from table(("", *AXES, "factor"), cells)
        yield (
            "Person by person, means: the first → the second, in how many the second is lower, 95 % "
            "interval of the mean difference, p of Wilcoxon's signed-rank test (two-sided, not corrected "
            "for the number of tests):"
        )
        yield ""
        yield from table(("", "", *PAIRED_HEADER), _pair_rows(people))


def _pair_rows(people: Mapping[str, Mapping[str, Judged]]) -> Iterator[list[str]]:
    titles = {entrant.name: entrant.title for entrant in ENTRANTS}
    for first, second in PAIRS:
        both = [name for name in people[first] if name in people[second]]
        for metric, title in COMPARED.items():
            figures = [[people[way][name].figures[metric] for way in (first, second)] for name in both]
            values = np.array(figures)
            if len(values):
                yield [f"{titles[first]} → {titles[second]}", title, *paired_cells(values)]
