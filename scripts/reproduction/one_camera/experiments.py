"""The thesis's experiments A, B and C (4.5): one camera against two, for one person."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from posetrack_cli.evaluation.metrics.head_metrics import HEAD_POSE
from reproduction.accuracy.measuring import number
from reproduction.one_camera import figures, overlays, population
from reproduction.one_camera.entrants import EXPERIMENTS, POPULATION
from reproduction.one_camera.measuring import Compared, Figures, Measured, Removed, compare
from reproduction.one_camera.options import Options
from reproduction.one_camera.tables import (
    TABLES,
    THESIS,
    THESIS_POINTS_MM,
    both_row,
    own_rows,
    six_table,
    thesis_rows,
)
from reproduction.running import Targets
from reproduction.steps import Chain

TITLES = {
    "A": "A: the person is in the model",
    "B": "B: the person is not in the model",
    "C": "C: adjusted at the start only",
}
SAID = {
    "A": "x, y and roll nearly agree with the estimates of two cameras; z, pitch and yaw, which are harder "
    "for one camera, are accurate, too. In head coordinates the points are 5.9 mm off on average, and "
    "deformations make no great errors (4.5 A).",
    "B": "The errors are larger than for a person who was learnt, most visibly in z, but accuracy does not "
    "break down: the model's own approximation error acts on the pose (4.5 B).",
    "C": "Without adjustment after each frame the estimates are much less stable, most visibly in z, of "
    "whose error mean and standard deviation grow (4.5 C).",
}
"""The thesis's statements, in our words."""
AGAINST: tuple[tuple[str, bool, Removed], ...] = (
    ("two cameras", True, "offset"),
    ("two cameras, depth factor removed", True, "factor"),
    ("two cameras, nothing removed", True, "nothing"),
    ("truth", False, "offset"),
    ("truth, depth factor removed", False, "factor"),
)
"""What is said, whether two cameras are the reference, and what is removed of the difference."""


class Experiments:
    """Tables 4.1 to 4.3 and figures 4.10 to 4.14."""

    name = "experiments"

    def chains(self, options: Options) -> list[Chain]:
        """The whole population's: its first person is looked at here."""
        return population.chains(options)

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """The tables one after the other, then the figures."""
        yield "## Experiments A, B and C (4.5)"
        yield ""
        yield _explained(options)
        yield ""
        person = options.persons[0]
        reference = population.stereo_result(options, person)
        if "x_mm" not in measured.figures(population.mono_result(options, person, "A"), reference):
            yield "Not measured: a result is missing."
            yield ""
            return
        for experiment in EXPERIMENTS:
            yield from _experiment(options, person, experiment, measured)
        yield from _compared(options, person, measured, targets)
        yield from _pictures(options, person)


def _explained(options: Options) -> str:
    first, last = options.modelled[0], options.modelled[-1]
    return (
        f"S = {options.model_people} synthetic persons ({first} to {last}) make the two motions before two "
        "cameras; `head build-model` takes A = 10 shapes of each from the stereo tracker's second pass. "
        f"Person {options.persons[0]} is then seen for {options.frames} frames of natural motion with all "
        "expressions. The reference is the second pass of two cameras, as in the thesis; the left camera "
        "alone is tracked. Mean and standard deviation of absolute errors, after one constant rigid offset "
        "of the head's frame; the thesis does not say whether it removed one, so errors with nothing removed "
        "stand beside. The thesis's figures are of one real person, ours of one synthetic one: the next part "
        "has more."
    )


def _experiment(options: Options, person: int, name: str, measured: Measured) -> Iterator[str]:
    """One table in the thesis's layout, and what one finds by other ways."""
    reference = population.stereo_result(options, person)
    yield f"### {TITLES[name]}"
    yield ""
    yield f"> **Thesis:** {SAID[name]}"
    yield ""
    yield f"Table {TABLES[name]}, one pass, against two cameras:"
    yield ""
    ours = measured.figures(population.mono_result(options, person, name), reference)
    yield from six_table("", [*thesis_rows(name), *own_rows("ours", ours)])
    yield "Mean ± sd of every way to measure it:"
    yield ""
    rows = (
        both_row(f"{entrant.title}, against {against}", found)
        for entrant in POPULATION
        if entrant.name.split("-")[0] == name
        for against, found in against_all(options, person, entrant.name, measured).items()
    )
    yield from six_table("", rows)


def against_all(options: Options, person: int, entrant: str, measured: Measured) -> Mapping[str, Figures]:
    """The figures of a result by what it is compared with."""
    result = population.mono_result(options, person, entrant)
    stereo = population.stereo_result(options, person)
    return {
        title: measured.figures(result, stereo if two_cameras else "", removed)
        for title, two_cameras, removed in AGAINST
    }


def _compared(options: Options, person: int, measured: Measured, targets: Targets) -> Iterator[str]:
    """What is beside the tables: points, the reference's own error, depth factors."""
    reference = population.stereo_result(options, person)
    found = {
        name: measured.figures(population.mono_result(options, person, name), reference)
        for name in EXPERIMENTS
    }
    truth = measured.figures(reference)
    yield "### Beside the tables"
    yield ""
    cells = ", ".join(f"{_short(name)} {truth[name]:.2f}" for name in HEAD_POSE)
    yield f"- The reference itself against the truth: {cells} (mm, deg)."
    factor = measured.figures(population.mono_result(options, person, "A"), reference, "factor")["factor"]
    yield f"- The depth factor that A would need: {factor:.4f}."
    points, shapes = found["A"]["points_mm"], found["A"]["shapes_mm"]
    yield (
        f"- Feature points in head coordinates, A: {points:.2f} mm from those of two cameras (thesis: "
        f"{THESIS_POINTS_MM}), {shapes:.2f} mm after each point's constant offset; "
        "both after one constant rigid movement."
    )
    for other in ("B", "C"):
        yield f"- {other} over A, means: {_ratios(found['A'], found[other])}."
    yield ""
    targets.add(
        "A: feature points in head coordinates, mm",
        f"<= {THESIS_POINTS_MM} (thesis)",
        number(points),
        points <= THESIS_POINTS_MM,
    )
    for name, figures_of in found.items():
        _judge(name, figures_of, targets)


def _judge(experiment: str, found: Figures, targets: Targets) -> None:
    """The means against the thesis's."""
    for name, limit in zip(HEAD_POSE, THESIS[experiment][0], strict=True):
        what = f"{experiment}, one pass, against two cameras: {_short(name)}"
        value = found.get(name)
        reached = None if value is None else value <= limit
        targets.add(what, f"<= {limit:g} (thesis)", "-" if value is None else number(value), reached)


def _ratios(one: Figures, other: Figures) -> str:
    return ", ".join(f"{_short(name)} {other[name] / one[name]:.2f}" for name in HEAD_POSE if name in other)


def _short(name: str) -> str:
    return name.rsplit("_", 1)[0]


def _pictures(options: Options, person: int) -> Iterator[str]:
    """Figures 4.10 to 4.14."""
    out = options.output
    stereo = out / population.stereo_result(options, person)
    results = {name: out / population.mono_result(options, person, name) for name in EXPERIMENTS}
    compared = {name: compare(path, stereo) for name, path in results.items() if path.exists()}
    overlays.draw(out / "figure4.10.png", out / population.test_recording(options, person), compared["A"])
    figures.points_over_time(out / "figure4.11.png", compared["A"])
    figures.poses_over_time(out / "figure4.12.png", _chosen(compared, "A"))
    figures.poses_over_time(out / "figure4.13.png", _chosen(compared, "A", "B"))
    figures.poses_over_time(out / "figure4.14.png", _chosen(compared, "A", "C"))
    for number_, text in _CAPTIONS.items():
        yield f"Figure {number_}: {text}"
        yield ""
        yield f"![Figure {number_}](figure{number_}.png)"
        yield ""


def _chosen(compared: Mapping[str, Compared], *names: str) -> dict[str, Compared]:
    return {name: compared[name] for name in names if name in compared}


_CAPTIONS = {
    "4.10": "two cameras (left), one camera (middle), and both from the subject's right (right; red: two "
    "cameras, blue: one; the camera is on the left; points as they are, axes after the constant offset), "
    "experiment A.",
    "4.11": "mean error of the feature points in head coordinates, experiment A.",
    "4.12": "pose of experiment A; red and thin: two cameras, blue and thick: one.",
    "4.13": "pose of experiments A and B.",
    "4.14": "pose of experiments A and C.",
}
