"""Recordings of faces that are not ours, with truth, seen by the left camera alone: the shipped model."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from posetrack_cli.evaluation.metrics.head_metrics import HEAD_POSE
from reproduction.accuracy.measuring import number
from reproduction.heads.people import persons_in
from reproduction.heads_data import TRUTH, reading_arguments
from reproduction.one_camera.entrants import PEOPLE
from reproduction.one_camera.measuring import Figures, Measured, Removed
from reproduction.one_camera.options import Options
from reproduction.one_camera.population import CAMERA, TRACKED
from reproduction.one_camera.tables import COLUMNS, EXPLAINED, THESIS, WAYS, mean_row
from reproduction.running import Targets, table
from reproduction.steps import Chain, Step

AIM = dict(zip(HEAD_POSE, (1.3, 1.6, 4.8, 0.22, 1.2, 1.2), strict=True))
"""Half of table 4.1."""
MOST_DEG = {"always": 1.2, "always-2": 1.0}
"""Of yaw and pitch, by entrant."""
TITLES = {"always": "one pass", "always-2": "two passes"}
ORDER = (("start", "always"), ("start-2", "always-2"), ("never", "start"), ("never-2", "start-2"))
"""The second is to be better than the first."""


class People:
    """Accuracy on every recording of a folder."""

    name = "people"

    def chains(self, options: Options) -> list[Chain]:
        """One for each person; none without a folder."""
        return [_chain(options, folder) for folder in _folders(options)]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """Tables per person, then the targets."""
        yield "## Recordings of other faces, left camera alone"
        yield ""
        folders = _folders(options)
        if not folders:
            yield "Not measured: no recordings were given (`--heads`)."
            yield ""
            return
        yield f"The shipped model, no parameter differs between them. {EXPLAINED}"
        yield ""
        for folder in folders:
            yield f"### {folder.name}"
            yield ""
            for removed, title in WAYS.items():
                yield from table((title, *COLUMNS, "factor", "ms"), _rows(folder, measured, removed))
            found = {entrant.name: _figures(folder, entrant.name, measured) for entrant in PEOPLE}
            judge(folder.name, found, targets)


def _folders(options: Options) -> list[Path]:
    return [] if options.heads is None else list(persons_in(options.heads))


def result_of(person: str, entrant: str) -> str:
    """Where a result lies, below the study's folder."""
    return f"runs/{person}-{entrant}.mcap"


def _chain(options: Options, folder: Path) -> Chain:
    """All entrants of a recording; its calibration becomes a camera file of ours."""
    reading = reading_arguments(folder, options.output / "recordings")
    alone = ("head", "mono", *reading, "--cameras", CAMERA)
    steps = (
        Step(result_of(folder.name, entrant.name), (*alone, *entrant.arguments, "--timings"))
        for entrant in PEOPLE
    )
    return Chain(folder.name, TRACKED, tuple(steps))


def _figures(folder: Path, entrant: str, measured: Measured, removed: Removed = "offset") -> Figures:
    return measured.figures(result_of(folder.name, entrant), str(folder / TRUTH), removed)


def _rows(folder: Path, measured: Measured, removed: Removed) -> Iterator[list[str]]:
    """The thesis's row, then a row for each entrant that has a result."""
    yield ["thesis, table 4.2", *map(number, THESIS["B"][0]), *["-"] * 5]
    yield ["aim: half of table 4.1", *map(number, AIM.values()), *["-"] * 5]
    for entrant in PEOPLE:
        figures = _figures(folder, entrant.name, measured, removed)
        if "x_mm" in figures:
            factor = number(figures["factor"], 4) if removed == "factor" else "-"
            told = [factor, number(figures["ms"], 1) if "ms" in figures else "-"]
            yield [*mean_row(entrant.title, [figures]), *told]


def judge(person: str, found: dict[str, Figures], targets: Targets) -> None:
    """Table 4.2 and half of 4.1, yaw and pitch, and the order of the ways to adjust."""
    for entrant, title in TITLES.items():
        figures, said = found.get(entrant, {}), f"{person}, {title}"
        for name, limit in zip(HEAD_POSE, THESIS["B"][0], strict=True):
            _add(targets, f"{said}: {_words(name)}", f"< {limit:g} (table 4.2)", figures.get(name), limit)
        for name, aim in AIM.items():
            _add(targets, f"{said}: {_words(name)}", f"<= {aim:g} (aim)", figures.get(name), aim)
        for name in ("pitch_deg", "yaw_deg"):
            most = MOST_DEG[entrant]
            _add(targets, f"{said}: {_words(name)}", f"<= {most:g}", figures.get(name), most)
    for first, second in ORDER:
        for name in ("position_mm", "rotation_deg"):
            values = [found.get(entrant, {}).get(name) for entrant in (first, second)]
            if None not in values:
                shown = " → ".join(number(float(value or 0.0)) for value in values)
                reached = bool((values[1] or 0.0) < (values[0] or 0.0))
                targets.add(f"{person}: {first} → {second}, {_words(name)}", "lower", shown, reached)


def _add(targets: Targets, what: str, asked: str, value: float | None, limit: float) -> None:
    shown = "-" if value is None else number(value)
    targets.add(what, asked, shown, None if value is None else bool(value <= limit))


def _words(name: str) -> str:
    """``pitch_deg`` as ``pitch, deg``."""
    return ", ".join(name.rsplit("_", 1))
