"""Tables in the layout of the thesis's 4.1 to 4.3, and the thesis's figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from posetrack_cli.evaluation.metrics.head_metrics import HEAD_POSE
from reproduction.accuracy.measuring import number
from reproduction.one_camera.measuring import Figures, Removed, values_of
from reproduction.running import table

Six = tuple[float, float, float, float, float, float]
THESIS: dict[str, tuple[Six, Six]] = {
    "A": ((2.60, 3.12, 9.56, 0.43, 2.45, 2.33), (2.24, 1.73, 9.69, 0.31, 2.08, 1.95)),
    "B": ((3.73, 1.92, 17.85, 0.43, 3.07, 2.49), (2.57, 1.47, 9.37, 0.32, 2.31, 1.96)),
    "C": ((2.71, 3.43, 11.38, 0.43, 2.52, 2.26), (2.11, 2.03, 11.43, 0.32, 2.03, 2.02)),
}
"""By experiment mean and standard deviation of the absolute errors, mm and deg (tables 4.1 to 4.3)."""
TABLES = {"A": "4.1", "B": "4.2", "C": "4.3"}
THESIS_POINTS_MM = 5.9
"""Mean error of the feature points in head coordinates, experiment A (4.5 A)."""
AXES = ("x, mm", "y", "z", "roll, deg", "pitch", "yaw")
WAYS: Mapping[Removed, str] = {
    "offset": "as measured",
    "factor": "depth factor removed",
    "nothing": "nothing removed",
}
"""What tables call what is removed of a difference."""
COLUMNS = (*AXES, "tracked", "first frame", "wrong")
EXPLAINED = (
    "Mean absolute errors over the frames in which the head was followed, after one constant rigid offset "
    "of the head's frame (`eval --align rigid`). Depth factor removed: also one common factor on all "
    "lengths, which one camera cannot see. Nothing removed: not even the offset, for it takes in what is "
    "constant of an error in z, and pays with errors in x and y that the head's turns make of it. Tracked: "
    "share of frames that do not say they are lost. First frame: the number, from 0, of the first one "
    "followed. Wrong: frames followed whose pose is off by more than 60 mm or 15 deg."
)


def thesis_rows(experiment: str) -> Iterator[list[str]]:
    """Mean and deviation as the thesis has them."""
    for said, values in zip(("mean", "sd"), THESIS[experiment], strict=True):
        yield [f"thesis, {said}", *map(number, values)]


def own_rows(title: str, figures: Figures) -> Iterator[list[str]]:
    """Ours likewise."""
    for said, ending in (("mean", ""), ("sd", " sd")):
        yield [f"{title}, {said}", *(_cell(figures, f"{name}{ending}") for name in HEAD_POSE)]


def both_row(title: str, figures: Figures) -> list[str]:
    """Mean and deviation in one cell each."""
    cells = (f"{_cell(figures, name)} ± {_cell(figures, f'{name} sd')}" for name in HEAD_POSE)
    return [title, *(cells if "x_mm" in figures else ["-"] * len(HEAD_POSE))]


def mean_row(title: str, found: Sequence[Figures]) -> list[str]:
    """Means over recordings; the latest first frame and the sum of wrong frames."""
    cells = [_mean(found, name) for name in HEAD_POSE]
    tracked, first, wrong = (values_of(found, name) for name in ("tracked", "first", "wrong"))
    return [
        title,
        *cells,
        number(float(tracked.mean()), 1, percent=True) if len(tracked) else "-",
        number(float(first.max()), 0) if len(first) else "-",
        number(float(wrong.sum()), 0) if len(wrong) else "-",
    ]


def six_table(first: str, rows: Iterable[Sequence[str]]) -> Iterable[str]:
    """A table of the six components."""
    return table((first, *AXES), rows)


def _cell(figures: Figures, name: str) -> str:
    return number(figures[name]) if name in figures else "-"


def _mean(found: Sequence[Figures], name: str) -> str:
    values = values_of(found, name)
    return number(float(values.mean())) if len(values) else "-"
