"""Do the standard deviations that a hand's measures are stated with hold the truth?"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hand_model.people import person_hand
from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.metrics.pose_errors import INSIDE_90
from posetrack_cli.hand.calibration.measures import MEASURES, measures_of
from posetrack_cli.hand.webxr import load_hand
from reproduction.accuracy.measuring import number
from reproduction.running import Targets, table
from reproduction.strangers.measuring import Measured
from reproduction.strangers.options import ARM, SHAPE_ALONE, Options
from reproduction.strangers.people import Person
from reproduction.strangers.tables import NOTHING, Column, Value, judge_intervals, noted, people_table
from reproduction.strangers.tasks import Task
from reproduction.strangers.tool import draw

OF_THE_WRIST = ("hand_length", "palm_length")
"""Where the wrist's centre lies in the skin no image tells, nor does a rule: it is the rig's convention."""
COUNTED = np.array([name not in OF_THE_WRIST for name in MEASURES])
_STATED = re.compile(r"^# ([a-z ]+) (\d+\.\d) \+- (\d+\.\d)$", re.MULTILINE)
COLUMNS = (
    Column("inside", "inside", 0, percent=True, target="80 to 97 %", whole="mean"),
    Column("largest", "largest error, sd", whole="max"),
    Column("of", "of the"),
    Column("hand_length_mm", "hand length, mm", 1, whole="mean"),
    Column("hand_length_error_mm", "off by, mm", 1, whole="mean"),
)
_TITLES = (
    "",
    "true, mm",
    "spread",
    "mean error",
    "rms error",
    "mean stated sd",
    "inside",
    "inside, joints of the rig",
)


@dataclass(frozen=True, eq=False)
class Known:
    """The measures (13,) of a person's hand, mm, in the order of ``MEASURES``.

    Attributes:
        stated, sd: as ``hand calibrate`` writes them.
        true: of the person's skin, with joints where our hands have them.
        of_rig: with the joints of the person's own rig.
    """

    stated: FloatArray
    sd: FloatArray
    true: FloatArray
    of_rig: FloatArray

    def errors(self, truth: str = "true") -> FloatArray:
        """Stated less true measures."""
        return np.asarray(self.stated - getattr(self, truth))

    def inside(self, truth: str = "true") -> FloatArray:
        """1 for each measure whose 90 % interval holds the truth, else 0."""
        return (np.abs(self.errors(truth)) <= INSIDE_90 * self.sd).astype(np.float64)


class Shapes:
    """The hands of everybody, estimated from their recordings, against those that were recorded."""

    name = "shape"

    def tasks(self, options: Options) -> list[Task]:
        """Everybody, with the arm."""
        return [_task(person, options) for person in options.people]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A row per measure, and one per person."""
        yield "## Stated sizes and proportions"
        yield ""
        yield (
            "Measures and standard deviations as `posetrack hand calibrate` writes them, told nothing, "
            "against the person's own hand. Inside: the share of 90 % intervals (1.645 standard deviations) "
            "that hold it. True is the person's skin with joints where our hands have them, by rules: "
            "knuckles where the first phalanx is 1.6 times the second, fingers divided as by Buryanov and "
            "Kotiuk 2010. Beside it stand the joints of the rig that drew the person. Lengths from the wrist "
            "are told, not counted: neither skin nor rule tells where in it the wrist's centre lies, so that "
            "is the rig's convention. Single phalanges are not compared: the rule divides all fingers alike. "
            "Spread: standard deviation of the true measure over the people, which is how far off a guess "
            "would be."
        )
        yield ""
        found = _known(options, measured)
        rows = {person: _figures(found.get(person)) for person in options.people}
        noted(measured, self.name, rows)
        every = list(found.values())
        if every:
            yield from table(_TITLES, list(_measure_rows(every, measured)))
        yield from people_table(COLUMNS, rows)
        whole = _share(every, "true") if every else None
        judge_intervals(targets, "shape: truth within stated 90 % intervals", whole)


def _task(person: Person, options: Options) -> Task:
    return options.task(person, ARM, SHAPE_ALONE)


def _known(options: Options, measured: Measured) -> dict[Person, Known]:
    """What is known of the people whose hands were estimated."""
    found = {}
    for person in options.people:
        text = measured.hand_file(_task(person, options), SHAPE_ALONE)
        if text:
            found[person] = Known(*stated_measures(text), *_true_measures(person, options))
    return found


def stated_measures(text: str) -> tuple[FloatArray, FloatArray]:
    """The measures (13,) and their standard deviations (13,) in a hand file's text, mm.

    Raises:
        KeyError: it does not state one of ``MEASURES``.
    """
    said = {name.replace(" ", "_"): (float(value), float(sd)) for name, value, sd in _STATED.findall(text)}
    values, sds = np.array([said[name] for name in MEASURES]).T
    return values, sds


def _true_measures(person: Person, options: Options) -> tuple[FloatArray, FloatArray]:
    """Those of the skin with our joints, and with the rig's; the mesh is drawn once more."""
    with tempfile.TemporaryDirectory() as folder:
        draw(options.tool.resolve(), Path(folder), person.recording(1))
        return true_measures(Path(folder) / "hand.glb")


def true_measures(mesh: Path) -> tuple[FloatArray, FloatArray]:
    """The measures (13,) of a file's hand, with joints where our hands have them, and where the file has."""
    return measures_of(person_hand(mesh, None).anatomy), measures_of(load_hand(mesh).anatomy)


def _figures(known: Known | None) -> dict[str, Value]:
    """The figures of a person, by the columns' names; none without an estimate."""
    if known is None:
        return {}
    off = np.where(COUNTED, np.abs(known.errors()) / known.sd, 0.0)
    length = MEASURES.index("hand_length")
    return {
        "inside": float(known.inside()[COUNTED].mean()),
        "largest": float(off.max()),
        "of": _title(MEASURES[int(off.argmax())]),
        "hand_length_mm": float(known.stated[length]),
        "hand_length_error_mm": float(known.errors()[length]),
    }


def _measure_rows(every: Sequence[Known], measured: Measured) -> Iterator[list[str]]:
    """A row per measure, and that of all that are counted."""
    rows = {name: _of_measure(every, k) for k, name in enumerate(MEASURES)}
    for name, row in rows.items():
        measured.note(f"{Shapes.name}, measures", name, row)
        counted = "" if name not in OF_THE_WRIST else " (not counted)"
        lengths = [_length(row[key]) for key in ("true", "spread", "error", "rms_error", "sd")]
        yield [f"{_title(name)}{counted}", *lengths, *_shares(row["inside"], row["inside_of_rig"])]
    inside, of_rig = (_share(every, truth) for truth in ("true", "of_rig"))
    measured.note(f"{Shapes.name}, measures", "counted", {"inside": inside, "inside_of_rig": of_rig})
    yield ["**all that are counted**", *[""] * 5, *_shares(inside, of_rig)]


def _of_measure(every: Sequence[Known], k: int) -> Mapping[str, float]:
    true, errors = np.array([one.true[k] for one in every]), np.array([one.errors()[k] for one in every])
    return {
        "true": float(true.mean()),
        "spread": float(true.std(ddof=1)) if len(true) > 1 else float("nan"),
        "error": float(errors.mean()),
        "rms_error": float(np.sqrt((errors**2).mean())),
        "sd": float(np.mean([one.sd[k] for one in every])),
        "inside": float(np.mean([one.inside()[k] for one in every])),
        "inside_of_rig": float(np.mean([one.inside("of_rig")[k] for one in every])),
    }


def _share(every: Sequence[Known], truth: str) -> float:
    return float(np.mean([one.inside(truth)[COUNTED] for one in every]))


def _shares(*shares: float) -> list[str]:
    return [number(share, 0, percent=True) for share in shares]


def _length(value: float) -> str:
    return number(value) if value == value else NOTHING


def _title(name: str) -> str:
    return name.replace("_", " ")
