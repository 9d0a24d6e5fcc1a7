"""Accuracy of the hand tracker on people that differ from its model."""

from __future__ import annotations

import itertools
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.build import version
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.measuring.catalogue import figure_of
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions
from posetrack_cli.evaluation.measuring.honesty import JudgedFrames, pooled_frames
from posetrack_cli.evaluation.measuring.measures import Measures
from posetrack_cli.evaluation.measuring.pooling import pool
from posetrack_cli.evaluation.measuring.pose_metrics import INSIDE_90
from posetrack_cli.evaluation.measuring.subjects.hand import FAR_MM
from posetrack_cli.evaluation.measuring.without_truth import honesty_metrics
from posetrack_cli.hand.confidence import RIGHT_MM
from posetrack_cli.hand.model.webxr import load_hand
from posetrack_cli.hand.shape_fit import MEASURES, measures_of
from posetrack_cli.results.topics import SMOOTHED
from research import cvar, hand_pairs, hands
from research.hand_accuracy import AVERAGE, NO_MESH
from research.hand_model.people import person_hand
from research.report import Column, Figures, Report, number, over, pairs_of, values_of
from research.runner import FILE, SHARED, TOOL, Files, Job, Step, tool_digest
from research.study import FOLDER, Part, Study, setting

FINAL = 900  # people and motions from this number on are for final measurements only
MOST_PEOPLE = 1000
_RANGE = re.compile(r"(\d{1,6})(?:-(\d{1,6}))?")


@dataclass(frozen=True)
class Person:
    """A stranger; the motion has the same number."""

    number: int

    @property
    def side(self) -> str:
        """Hand that is shown: the left one for odd numbers."""
        return "left" if self.number % 2 else "right"

    @property
    def shows_back(self) -> bool:
        """Whether the back of the hand faces the camera: every third person."""
        return self.number % 3 == 0

    @property
    def title(self) -> str:
        """Return the person's name in tables."""
        return f"{self.number} {self.side}{', back' if self.shows_back else ''}"

    def drawing(self, frames: int, *more: str) -> tuple[str, ...]:
        """Return the arguments for the tool that renders a recording."""
        seeds = ("--person", str(self.number), "--motion", str(self.number), "--frames", str(frames))
        left = ("--left",) if self.side == "left" else ()
        return (*seeds, *left, *(("--back",) if self.shows_back else ()), *more)


def people_of(text: str, *, final: bool) -> tuple[Person, ...]:
    """Parse people such as ``800-819`` or ``800,803-805``; return them sorted without duplicates.

    Args:
        text: numbers and inclusive ranges, separated by commas.
        final: whether to allow people reserved for final measurements.
    """
    found: set[int] = set()
    for part in text.split(","):
        match = _RANGE.fullmatch(part.strip())
        numbers = range(int(match[1]), int(match[2] or match[1]) + 1) if match else range(0)
        if not 0 < len(numbers) <= MOST_PEOPLE:
            expected = f"numbers and ranges such as 800-819, of at most {MOST_PEOPLE} people"
            raise UsageError("invalid --people", found=repr(text), expected=expected)
        found |= set(numbers)
    if max(found) >= FINAL and not final:
        expected, hint = f"less than {FINAL}", "--final allows such people"
        raise UsageError(
            "person is reserved for final measurements", found=max(found), expected=expected, hint=hint
        )
    return tuple(map(Person, sorted(found)))


# Recordings and entrants

ARM, NO_ARM, DOUBLE_SPEED, FREE_ELBOW = "arm", "no-arm", "double-speed", "free-elbow"
# Further arguments of the tool by kind of recording
RECORDINGS = {ARM: (), NO_ARM: ("--no-arm",), DOUBLE_SPEED: ("--speed", "2"), FREE_ELBOW: ("--free-elbow",)}
EXACT_KINDS, DEFAULT_KINDS = (ARM, NO_ARM, DOUBLE_SPEED), (ARM, DOUBLE_SPEED)
# Entrants: the person's own mesh; defaults; the mesh and true keypoints; ``hand calibrate``
EXACT, DEFAULT, TOLD, SHAPE_ALONE = "mesh", "default", "told", "shape"
# Entrants that differ from the default in one setting and use side and shape from its result
CHOICES = {
    "pf": ("plain filter", ("--filter", "pf")),
    "paper": ("the paper's cost", ("--cost", "paper")),
    "union": ("union cost", ("--cost", "union")),
    "pso": ("swarm", ("--filter", "pso")),
}
AVERAGE_HAND = "average"


@dataclass(frozen=True)
class Options:
    """Settings of the study."""

    output: Path
    tool: Path  # renders the strangers' hands; not a part of the project
    people: tuple[Person, ...]
    frames: int = setting("--frames", 300, "Frames per recording.", 2)
    # folder of the annotated, head-mounted recordings; None to skip them
    cvar: Path | None = setting(  # noqa: RUF009
        "--cvar", None, "Folder with P1, P4, P7.  [default: ../shared/data/cvar-hand]", type=FOLDER
    )

    def name(self, person: Person, kind: str) -> str:
        """Return the name of a recording."""
        return f"{person.number}-{kind}-{self.frames}"

    def result(self, person: Person, kind: str, entrant: str) -> str:
        """Return the path of a result or hand file."""
        return f"runs/{self.name(person, kind)}-{entrant}.{'toml' if entrant == SHAPE_ALONE else 'mcap'}"

    def jobs(self, person: Person, kind: str, *entrants: str) -> Iterator[Job]:
        """Yield the jobs that render and track a recording of a person, and write the person's mesh."""
        mesh = f"meshes/{person.number}"
        yield Job(mesh, (Step(mesh, (TOOL, str(self.tool), *person.drawing(1))),))
        name = self.name(person, kind)
        drawn, recording = f"drawn/{name}", f"recordings/{name}.mcap"
        arguments = (TOOL, str(self.tool), *person.drawing(self.frames, *RECORDINGS[kind]))
        converted = ("convert", f"{FILE}{drawn}/depth", "--truth", f"{FILE}{drawn}/truth.csv")
        exact = ("--hand-mesh", f"{FILE}{mesh}/hand.glb", "--smooth", *NO_MESH)
        found = ("--shape", FILE + self.result(person, kind, DEFAULT), *NO_MESH)
        ways = {
            DEFAULT: NO_MESH,
            EXACT: exact,
            TOLD: (*exact, "--keypoints", f"{FILE}{drawn}/truth.csv"),
            AVERAGE_HAND: (*AVERAGE, *NO_MESH),
            **{entrant: (*changed, *found) for entrant, (_, changed) in CHOICES.items()},
        }
        steps = [Step(drawn, arguments, scratch=True), Step(recording, converted, scratch=True)]
        for entrant in entrants:
            command = ("hand", "calibrate") if entrant == SHAPE_ALONE else ("hand", "run")
            more = ways.get(entrant, ())
            steps.append(Step(self.result(person, kind, entrant), (*command, FILE + recording, *more)))
        yield Job(name, tuple(steps))


def tracked(options: Options, kinds: Sequence[str], *entrants: str, most: int | None = None) -> Iterator[Job]:
    """Yield the jobs for all recordings of some kinds, of at most ``most`` people."""
    for person, kind in itertools.product(options.people[:most], kinds):
        yield from options.jobs(person, kind, *entrants)


Rows = Mapping[Person, Figures]


def _titled(rows: Rows) -> dict[str, Figures]:
    return {person.title: figures for person, figures in rows.items()}


def _groups(rows: Rows) -> dict[str, list[str]]:
    """Group people: all, palm and back."""
    groups = {"**all**": [person.title for person in rows]}
    for title, back in (("palms", False), ("backs", True)):
        groups[title] = [person.title for person in rows if person.shows_back is back]
    return groups


# The person's own mesh, and smoothing

ERROR, TIPS = Column("error_mm", "error, mm"), Column("tip_error_mm", "tips, mm")
LOST = Column("lost", "lost frames", 0, whole="sum")
FOUND = Column("found_within", "found within, frames", 0, whole="max")
MESH_COLUMNS = (
    ERROR,
    Column("no_arm_error_mm", "without arm, mm"),
    Column("arm_ratio", "ratio"),
    Column("double_speed_error_mm", "double speed, mm"),
    LOST,
)
SMOOTH_COLUMNS = (
    Column("error_mm", "filtered, mm"),
    Column("smoothed_error_mm", "smoothed, mm"),
    Column("smooth_ratio", "ratio", 3),
)


def _mesh_figures(options: Options, files: Files) -> dict[Person, dict[str, float]]:
    rows = {}
    for person in options.people:
        arm, *others = (files.made(options.result(person, kind, EXACT)) for kind in EXACT_KINDS)
        row = hands.figures_of(arm)
        for name, path in zip(("no_arm", "double_speed"), others, strict=True):
            if figures := hands.figures_of(path):
                row[f"{name}_error_mm"] = figures["error_mm"]
        if {"error_mm", "no_arm_error_mm"} <= row.keys():
            row["arm_ratio"] = row["error_mm"] / row["no_arm_error_mm"]
        if smoothed := hands.figures_of(arm, SMOOTHED):
            row["smoothed_error_mm"] = smoothed["error_mm"]
            row["smooth_ratio"] = smoothed["error_mm"] / row["error_mm"]
        rows[person] = row
    return rows


def _report_mesh(options: Options, files: Files, report: Report) -> None:
    report.text(
        "## With the person's exact mesh",
        "Automatic start, the side is not given. Errors: mean over the 21 joints and all frames, lost ones "
        "included. Ratio: with arm over without.",
    )
    rows = _mesh_figures(options, files)
    report.figures("mesh", MESH_COLUMNS, _titled(rows))
    for what, name, most in (
        ("exact mesh: mean joint error, mm", "error_mm", 4.0),
        ("exact mesh: error with arm over without", "arm_ratio", 1.25),
        ("exact mesh, double speed: mean joint error, mm", "double_speed_error_mm", 6.0),
    ):
        report.judge(what, over(rows.values(), name), most=most)


def _report_smooth(options: Options, files: Files, report: Report) -> None:
    report.text(
        "## Smoothed against filtered",
        "Mean joint errors with the exact mesh; ratio: smoothed over filtered.",
    )
    rows = _mesh_figures(options, files)
    report.figures("smooth", SMOOTH_COLUMNS, _titled(rows))
    ratios = values_of(rows.values(), "smooth_ratio")
    better = float((ratios < 1.0).sum()) if len(ratios) else None
    report.judge(f"smoothing: better, of {len(ratios)}", better, least=math.ceil(0.9 * len(ratios)), digits=0)
    report.judge("smoothing: worst ratio", over(rows.values(), "smooth_ratio", "max"), most=1.02, digits=3)


# By default, nothing given

DEFAULT_COLUMNS = (
    Column("side_right", "side right", 0, whole="sum"),
    FOUND,
    Column("off", f"wrist > {hands.OFF_MM:g} mm off, not lost", 0, whole="sum"),
    *(ERROR, TIPS, Column("error_without_offsets_mm", "offsets removed, mm"), LOST),
    Column("fast error_without_offsets_mm", "double speed, offsets removed, mm"),
    Column("fast tip_error_mm", "tips, mm"),
    Column("fast lost", "lost frames", 0, whole="sum"),
    *(Column(name, title, 0) for name, title in hands.VELOCITIES.items()),
)
ELBOW_PEOPLE = 5
ELBOW_COLUMNS = (
    FOUND,
    Column("kept", f"frames with the wrist < {hands.OFF_MM:g} mm off", 1, percent=True),
    *(ERROR, LOST),
)


def _report_default(options: Options, files: Files, report: Report) -> None:
    report.text(
        "## Defaults",
        "The same recordings, nothing given. Found within: the first frame, from 1, on the true wrist that "
        "is not lost. Offsets removed: one constant offset per joint, in the axes of its bone.",
    )
    rows = {}
    for person in options.people:
        usual, fast = (files.made(options.result(person, kind, DEFAULT)) for kind in DEFAULT_KINDS)
        row = {**hands.figures_of(usual), **hands.start_of(usual), **hands.without_offsets(usual)}
        row |= hands.velocities_of(usual)
        if usual is not None:
            row["side_right"] = float(hands.side_of(usual) == person.side)
        more = {**hands.figures_of(fast), **hands.without_offsets(fast)}
        rows[person] = row | {f"fast {name}": value for name, value in more.items()}
    report.figures("default", DEFAULT_COLUMNS, _titled(rows), _groups(rows))
    sides, off, found = (values_of(rows.values(), name) for name in ("side_right", "off", "found_within"))
    known = len(sides)
    right, count, quick = (
        float(of.sum()) if known else None for of in (sides, off, (found <= 5).astype(float))
    )
    report.judge(f"defaults: side right, of {known}", right, least=known, digits=0)
    title = f"defaults: frames with the wrist > {hands.OFF_MM:g} mm off and not lost"
    report.judge(title, count, most=0, digits=0)
    report.judge(f"defaults: found within 5 frames, of {known}", quick, least=known, digits=0)
    for name, what, most in (
        ("error_without_offsets_mm", "offsets removed: mean joint error, mm", 3.0),
        ("tip_error_mm", "fingertips, mm", 5.0),
        ("fast error_without_offsets_mm", "double speed, offsets removed: mean joint error, mm", 4.5),
        ("fast tip_error_mm", "double speed: fingertips, mm", 8.0),
    ):
        report.judge(f"defaults, {what}", over(rows.values(), name), most=most)
    worst = over(rows.values(), "error_without_offsets_mm", "max")
    report.judge("defaults, offsets removed: worst recording, mm", worst, most=4.5)


def _report_elbow(options: Options, files: Files, report: Report) -> None:
    report.text("## Free elbow", "Defaults, without an upper arm. Kept: whatever the status says.")
    rows = {}
    for person in options.people[:ELBOW_PEOPLE]:
        result = files.made(options.result(person, FREE_ELBOW, DEFAULT))
        rows[person] = hands.figures_of(result) | hands.start_of(result)
    report.figures("free-elbow", ELBOW_COLUMNS, _titled(rows))


# Honesty

# Of Oberweger et al. (CVPR 2016), head-mounted, whose joints are marked by another convention.
SEQUENCES = ("P1", "P4", "P7")
HONESTY_COLUMNS = (
    Column("frames", "frames", 0),
    Column("frames_wrong", "wrong", 2, percent=True),
    Column("confidence_roc_area", "area", 3),
    Column("frames_far_tracked", "far, not lost", 2, percent=True),
    Column("confidence_brier_score", "Brier score", 3),
    Column("confidence_calibration_error", "calibration error", 3),
)


def cvar_jobs(options: Options, *, told: bool = False) -> Iterator[Job]:
    """Yield the jobs for the existing head-mounted recordings, with defaults and with true keypoints."""
    for name in _sequences(options):
        assert options.cvar is not None
        made = cvar.conversion(options.cvar / name, options.output)
        recording = Step(f"recordings/{name}.mcap", made, scratch=True)
        run = ("hand", "run", FILE + recording.output, *NO_MESH)
        steps = [recording, Step(f"runs/{name}-{DEFAULT}.mcap", run)]
        if told:
            points = ("--keypoints", str(options.output / f"{name}.csv"))
            steps.append(Step(f"runs/{name}-{TOLD}.mcap", (*run, *points)))
        yield Job(name, tuple(steps))


def _sequences(options: Options) -> list[str]:
    return [] if options.cvar is None else [name for name in SEQUENCES if (options.cvar / name).is_dir()]


def confidence_figures(judged: JudgedFrames) -> dict[str, float]:
    """Return the metrics of ``posetrack eval`` on confidence and status by address."""
    measures = Measures("no frame has a truth")
    honesty_metrics(measures, judged)
    known = {name: float(value) for name, value in measures.metrics.items() if isinstance(value, float | int)}
    return {"frames": float(len(judged.right)), **known}


def _report_honesty(options: Options, files: Files, report: Report) -> None:
    report.text(
        "## Honesty",
        f"Wrong is a frame whose mean joint error is above {RIGHT_MM:g} mm; offsets: after one constant "
        "offset per joint. Pooled are all results of the parts `mesh` and `default`, and P1, P4, P7. Area: "
        f"under the ROC curve of confidence. Far: frames more than {FAR_MM:g} mm off that are not lost.",
    )
    ways = ((EXACT, EXACT_KINDS), (DEFAULT, DEFAULT_KINDS))
    outputs = [options.result(p, kind, way) for p in options.people for way, of in ways for kind in of]
    results = [path for one in outputs if (path := files.made(one)) is not None]
    heads = {name: files.made(f"runs/{name}-{DEFAULT}.mcap") for name in _sequences(options)}
    known = {name: path for name, path in heads.items() if path is not None}
    groups = {"all pooled": ([*results, *known.values()], hands.RAW, 0.9)}
    for name, path in known.items():
        groups[name] = ([path], hands.RAW, 0.75)
        groups[f"{name}, offsets"] = ([path], hands.WITHOUT_OFFSETS, 0.75)
    groups["P1, P4, P7, offsets"] = (list(known.values()), hands.WITHOUT_OFFSETS, 0.75)
    rows = {name: _confidence(paths, how) for name, (paths, how, _) in groups.items()}
    report.figures("honesty", HONESTY_COLUMNS, rows, {})
    for name, (_, _, least) in groups.items():
        area = rows[name].get("confidence_roc_area")
        report.judge(f"confidence, {name}: area under the ROC curve", area, least=least, digits=3)
    far = rows["all pooled"].get("frames_far_tracked")
    report.judge(f"frames > {FAR_MM:g} mm off that are not lost", far, most=0.01, percent=True)
    exact = [files.made(options.result(person, ARM, EXACT)) for person in options.people]
    evaluations = [hands.evaluated(path) for path in exact if path is not None]
    together = pool("exact mesh", evaluations) if evaluations else None
    for what, address in (("joints", "joint_inside_90"), ("the wrist", f"joint_inside_90.{hands.WRIST}")):
        share = None if together is None else figure_of(together, address).value
        title = f"exact mesh: truth within 90 % intervals, {what}"
        report.judge(title, share, least=0.80, most=0.97, digits=1, percent=True)


def _confidence(results: Sequence[Path], how: EvalOptions) -> dict[str, float]:
    judged = [one for path in results if (one := hands.evaluated(path, how).judged) is not None]
    return confidence_figures(pooled_frames(judged)) if judged else {}


# True keypoints given

TOLD_COLUMNS = (
    Column("error_mm", "error, mm"),
    Column("told_error_mm", "with keypoints, mm"),
    Column("off", "frames off", 0, whole="sum"),
    Column("mended", "of these right with keypoints", 0, whole="sum"),
)
MOST_MM = {"P1": 18.0, "P4": 9.0, "P7": 12.0}


def _report_told(options: Options, files: Files, report: Report) -> None:
    report.text(
        "## With true keypoints",
        "Fits of every frame also start from the true joints (`--keypoints`). A frame that is off, but right "
        "with keypoints, is a failure of the search: the truth costs less. If it is off both times, another "
        "pose costs less than the truth. People with the exact mesh: off from 10 mm; P1, P4, P7 with "
        f"defaults, offsets per bone removed: off from {RIGHT_MM:g} mm.",
    )
    found = {}
    for person in options.people:
        results = [files.made(options.result(person, ARM, entrant)) for entrant in (EXACT, TOLD)]
        found[person.title] = _mended(results, hands.RAW, 10.0)
    report.figures("told", TOLD_COLUMNS, found)
    rows = {}
    for name in _sequences(options):
        results = [files.made(f"runs/{name}-{entrant}.mcap") for entrant in (DEFAULT, TOLD)]
        rows[name] = _mended(results, hands.WITHOUT_OFFSETS, RIGHT_MM)
    report.figures("told, head-mounted", TOLD_COLUMNS, rows, {})
    for name, most in MOST_MM.items():
        error = rows.get(name, {}).get("error_mm")
        report.judge(f"{name}, offsets removed: mean joint error, mm", error, most=most)


def _mended(results: Sequence[Path | None], how: EvalOptions, off_mm: float) -> dict[str, float]:
    plain, told = (None if path is None else hands.frames_of(hands.evaluated(path, how)) for path in results)
    if plain is None or told is None:
        return {}
    off = plain.error > off_mm
    errors = {"error_mm": float(plain.error.mean()), "told_error_mm": float(told.error.mean())}
    return errors | {"off": float(off.sum()), "mended": float((told.error[off] <= off_mm).sum())}


# Filter, cost, shape, optimiser

CHOSEN = {
    DEFAULT: "default",
    **{name: title for name, (title, _) in CHOICES.items()},
    AVERAGE_HAND: "average hand",
}
CHOICE_COLUMNS = (
    Column("error_mm", "error, mm", spread=True),
    Column("error_without_offsets_mm", "offsets removed, mm", spread=True),
    Column("lost", "lost frames", 0, whole="sum"),
)
QUESTIONS = (
    ("Does velocity help? Plain filter → RBPF", "pf", DEFAULT),
    ("Which pixels cost? The paper's → union", "paper", "union"),
    ("A mixture per pixel? Union → default", "union", DEFAULT),
    ("Does the shape help? Average → estimated", AVERAGE_HAND, DEFAULT),
    ("An optimiser instead? Swarm → default", "pso", DEFAULT),
    ("The paper's cost → default", "paper", DEFAULT),
)


def _report_choices(options: Options, files: Files, report: Report) -> None:
    report.text(
        "## Filter, cost and shape",
        "The recordings of the part `default`, tracked with one setting changed: `--filter pf`, `--cost "
        "paper`, `--cost union`, `--filter pso` (64 particles, 25 generations), all with the side and "
        "shape of the default run; and `--shape average` with nothing given.",
    )
    rows = {
        entrant: {
            str(person.number): hands.figures_of(result) | hands.without_offsets(result)
            for person in options.people
            if (result := files.made(options.result(person, ARM, entrant))) is not None
        }
        for entrant in CHOSEN
    }
    titled = {title: list(rows[entrant].values()) for entrant, title in CHOSEN.items()}
    report.entrants("choices", CHOICE_COLUMNS, titled)
    errors = {"raw": "error_mm", "offsets removed": "error_without_offsets_mm"}
    chosen_pairs = {
        (question, kind): pairs_of(rows[first], rows[second], name)
        for question, first, second in QUESTIONS
        for kind, name in errors.items()
    }
    report.pairs("choices, paired", ("", "errors, mm"), chosen_pairs)


# Stated sizes and proportions

# The position of the wrist in the skin is a convention of the rig; no image determines it
OF_THE_WRIST = ("hand_length", "palm_length")
COUNTED = np.array([name not in OF_THE_WRIST for name in MEASURES])
_STATED = re.compile(r"^# ([a-z ]+) (\d+\.\d) \+- (\d+\.\d)$", re.MULTILINE)
SHAPE_COLUMNS = (
    Column("true", "true, mm"),
    Column("spread", "spread"),
    Column("error", "mean error"),
    Column("rms", "rms error"),
    Column("sd", "mean stated sd"),
    Column("inside", "inside", 0, percent=True),
    Column("inside_of_rig", "inside, joints of the rig", 0, percent=True),
)


def stated_measures(text: str) -> tuple[FloatArray, FloatArray]:
    """Return the measures (13,) and their standard deviations (13,) of a hand file, mm."""
    said = {name.replace(" ", "_"): (float(value), float(sd)) for name, value, sd in _STATED.findall(text)}
    values, sds = np.array([said[name] for name in MEASURES]).T
    return values, sds


def true_measures(mesh: Path) -> tuple[FloatArray, FloatArray]:
    """Return the measures (13,) of a mesh, with our joints and with those of the file."""
    return measures_of(person_hand(mesh, None).anatomy), measures_of(load_hand(mesh).anatomy)


def _report_shape(options: Options, files: Files, report: Report) -> None:
    report.text(
        "## Stated sizes and proportions",
        "Measures and standard deviations from `posetrack hand calibrate`, nothing given, against the "
        "person's own hand. Inside: share of 90 % intervals (1.645 standard deviations) with the true "
        "value. True: the person's skin with joints by our rules (first phalanx 1.6 times the second, "
        "fingers as by Buryanov and Kotiuk 2010); the last column uses the joints of the person's rig. "
        "Lengths from the wrist are not counted. Spread: standard deviation of the true measure over people.",
    )
    known = []
    for person in options.people:
        stated, mesh = (
            files.made(options.result(person, ARM, SHAPE_ALONE)),
            files.made(f"meshes/{person.number}"),
        )
        if stated is not None and mesh is not None:
            measures = stated_measures(stated.read_text("utf-8"))
            known.append((*measures, *true_measures(mesh / "hand.glb")))
    inside = None
    if known:
        rows, inside, of_rig = shape_figures(*map(np.array, zip(*known, strict=True)))
        report.figures("shape", SHAPE_COLUMNS, rows, {})
        both = [number(share, 1, percent=True) for share in (inside, of_rig)]
        report.text(f"Inside, of all that are counted: {both[0]}, with the joints of the rig {both[1]}.")
    title = "shape: truth within stated 90 % intervals"
    report.judge(title, inside, least=0.80, most=0.97, digits=1, percent=True)


def shape_figures(
    stated: FloatArray, sd: FloatArray, true: FloatArray, of_rig: FloatArray
) -> tuple[dict[str, dict[str, float]], float, float]:
    """Return figures per measure, and the shares within 90 % intervals by our joints and by the rig's.

    All arguments are (P, 13) for P people, mm.
    """
    errors = stated - true
    inside, inside_of_rig = (np.abs(stated - one) <= INSIDE_90 * sd for one in (true, of_rig))
    columns = {
        "true": true.mean(axis=0),
        "spread": true.std(axis=0, ddof=1) if len(true) > 1 else np.full(len(MEASURES), np.nan),
        "error": errors.mean(axis=0),
        "rms": np.sqrt((errors**2).mean(axis=0)),
        "sd": sd.mean(axis=0),
        "inside": inside.mean(axis=0),
        "inside_of_rig": inside_of_rig.mean(axis=0),
    }
    rows = {
        name.replace("_", " "): {column: float(values[k]) for column, values in columns.items()}
        for k, name in enumerate(MEASURES)
    }
    return rows, float(inside[:, COUNTED].mean()), float(inside_of_rig[:, COUNTED].mean())


def _numbers(options: Options) -> tuple[int, ...]:
    return tuple(person.number for person in options.people)


def _head(options: Options) -> Iterator[str]:
    yield "# Hand tracker on strangers"
    people = ", ".join(str(person.number) for person in options.people)
    yield (
        f"posetrack {version()}; {len(options.people)} people ({people}), drawn by `{options.tool.name}`, "
        f"digest {tool_digest(options.tool)[:12]}; {options.frames} frames each; "
        f"{'with' if options.cvar else 'without'} the head-mounted recordings; {os.cpu_count()} cores."
    )


def _options(
    output: Path, frames: int, cvar: Path | None, people: str, final: bool, tool: Path | None
) -> Options:
    found, annotated = (tool or SHARED / "tools" / "foreign_hand.py").resolve(), SHARED / "data" / "cvar-hand"
    if not found.is_file():
        hint = "give the path of foreign_hand.py with --tool"
        raise UsageError("tool for rendering strangers' hands not found", where=found, hint=hint)
    known = cvar or (annotated if annotated.is_dir() else None)
    return Options(output, found, people_of(people, final=final), frames, known)


STUDY = Study(
    "hand-strangers",
    Options,
    (
        Part("mesh", lambda options: tracked(options, EXACT_KINDS, EXACT), _report_mesh),
        Part("default", lambda options: tracked(options, DEFAULT_KINDS, DEFAULT), _report_default),
        Part(
            "free-elbow",
            lambda options: tracked(options, (FREE_ELBOW,), DEFAULT, most=ELBOW_PEOPLE),
            _report_elbow,
        ),
        Part(
            "honesty",
            lambda options: (
                *tracked(options, EXACT_KINDS, EXACT),
                *tracked(options, DEFAULT_KINDS, DEFAULT),
                *cvar_jobs(options),
            ),
            _report_honesty,
        ),
        Part("smooth", lambda options: tracked(options, (ARM,), EXACT), _report_smooth),
        Part(
            "told",
            lambda options: (*tracked(options, (ARM,), EXACT, TOLD), *cvar_jobs(options, told=True)),
            _report_told,
        ),
        Part("choices", lambda options: tracked(options, (ARM,), *CHOSEN), _report_choices),
        Part("shape", lambda options: tracked(options, (ARM,), SHAPE_ALONE), _report_shape),
        Part(
            "both",
            lambda options: hand_pairs.jobs(_numbers(options), options.tool),
            lambda options, files, report: hand_pairs.report(_numbers(options), files, report),
        ),
    ),
    _head,
    __doc__,
    more=(
        click.option("--people", default="800-819", show_default=True, help="Numbers, ranges, commas."),
        click.option(
            "--final", is_flag=True, help="Allow people from 900 on: final measurements, never tuning."
        ),
        click.option(
            "--tool",
            type=click.Path(path_type=Path),
            help="foreign_hand.py.  [default: that in ../shared/tools]",
        ),
    ),
    made=_options,
)
