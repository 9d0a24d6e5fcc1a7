"""Accuracy of the head trackers, with one and two cameras, on people never used for tuning."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.build import version
from posetrack_cli.evaluation.measuring.catalogue import figure_of
from posetrack_cli.evaluation.measuring.honesty import roc_area
from posetrack_cli.evaluation.reading.truth_tables import load_csv_track
from posetrack_cli.geometry.camera import pixels_from_points
from posetrack_cli.head.subject import head_subject
from research import heads
from research.report import Column, Figures, Report, over, pairs_of, values_of, whole
from research.runner import FILE, Files, Job, Step
from research.study import FOLDER, HEADS, Part, Study, setting

WRONG_DEG = 3.0  # rotation error above which a frame is wrong
COLUMNS = (
    *heads.POSE_COLUMNS,
    Column("factor", "right depth factor", 3, whole="median"),
    Column("points_px", "first points, px"),
    Column("tracked", "tracked", 1, percent=True),
    Column("off", "off", 1, percent=True),
    Column("position_inside", "position inside"),
    Column("rotation_inside", "rotation inside"),
    Column("ms", "ms", 1),
)


@dataclass(frozen=True)
class Options:
    """Settings of the study."""

    output: Path
    heads: Path = setting("--heads", None, HEADS, type=FOLDER, required=True)  # noqa: RUF009
    tuned: Path | None = setting(  # noqa: RUF009
        "--tuned", None, "Folder of recordings of people that defaults were tuned on.", type=FOLDER
    )
    left_out: Path | None = setting(  # noqa: RUF009
        "--left-out",
        None,
        "Folder of models learned without each stranger: NAME-features.npz from build face-features "
        "--without NAME, NAME-model.npz from build face-model --without NAME.  [default: shipped models]",
        type=FOLDER,
    )
    only: tuple[str, ...] = setting(
        "--person", (), "Only this person; repeatable.", multiple=True, metavar="NAME"
    )

    @property
    def strangers(self) -> list[Path]:
        """Folders of people never used for tuning."""
        return [one for one in heads.persons_in(self.heads) if not self.only or one.name in self.only]

    @property
    def familiar(self) -> list[Path]:
        """Folders of people used for tuning."""
        return [one for one in heads.persons_in(self.tuned) if not self.only or one.name in self.only]

    @property
    def everybody(self) -> list[Path]:
        """Folders of all people."""
        return [*self.strangers, *self.familiar]

    def mono(self, person: Path, *arguments: str) -> tuple[str, ...]:
        """Return the command for a person's left camera, with models learned without the person."""
        learned: tuple[str, ...] = ()
        if self.left_out is not None and person.parent == self.heads:
            features, model = (self.left_out / f"{person.name}-{what}.npz" for what in ("features", "model"))
            learned = ("--set", f"start.detection.features={features}", "--face-model", str(model))
        reading = heads.reading_arguments(person, self.output / "recordings")
        return ("head", "mono", *reading, "--cameras", heads.LEFT, "--timings", *learned, *arguments)


class Judged(NamedTuple):
    """A result compared with ground truth, M frames."""

    figures: Mapping[str, float]  # means over the followed frames
    first_px: FloatArray  # (K, 2) image errors of the points in the first followed frame
    confidence: FloatArray  # (M,)
    wrong: BoolArray  # (M,) whether the rotation error exceeds ``WRONG_DEG`` after alignment


def judge(result: Path, person: Path) -> Judged:
    """Compare a result with the ground truth of a person."""
    truth = person / heads.TRUTH
    one, raw = heads.compare(result, truth), heads.evaluated(result, truth, "none")
    found = heads.mono_figures(result, truth)
    wrong = one.rotation_deg > WRONG_DEG
    found["off"] = float(wrong[one.followed].mean()) if one.followed.any() else np.nan
    for part in ("position", "rotation"):
        found[f"{part}_inside"] = figure_of(raw, f"inside_90.{part}").value or 0.0
    return Judged(found, first_points(one, person), np.nan_to_num(one.confidence), wrong)


def first_points(one: heads.Compared, person: Path) -> FloatArray:
    """Return the image errors (K, 2) of the points in the first followed frame, pixels."""
    camera, row = heads.cameras_of(person / heads.CALIBRATION)[0], int(np.argmax(one.followed))
    mine, theirs = (pixels_from_points(camera, points[row])[0] for points in (one.points, one.true_points))
    off: FloatArray = mine - theirs
    return off


def without_others(offsets: Sequence[FloatArray]) -> FloatArray:
    """Return lengths (P, K) of the point errors (K, 2) of P people after removing the mean of the others.

    The offset of a detected point from a mesh vertex is a convention, but the person under test must not
    contribute to it. For a single person, nothing is removed.
    """
    every = np.array(offsets)
    others = (every.sum(axis=0) - every) / (len(every) - 1) if len(every) > 1 else np.zeros_like(every)
    lengths: FloatArray = np.linalg.norm(every - others, axis=-1)
    return lengths


def judged_people(folders: Sequence[Path], kind: str, files: Files) -> dict[str, Judged]:
    """Return the comparisons of people with a result of a kind by name."""
    found = {folder: files.made(f"runs/{folder.name}-{kind}.mcap") for folder in folders}
    return {folder.name: judge(path, folder) for folder, path in found.items() if path is not None}


def _report_people(part: str, options: Options, files: Files, report: Report) -> list[Figures]:
    """Add the table of a part: strangers with median and worst, then people used for tuning."""
    rows: dict[str, dict[str, Figures]] = {"": {}, " (tuned on)": {}}
    for folders, (ending, of) in zip((options.strangers, options.familiar), rows.items(), strict=True):
        people = judged_people(folders, part, files)
        left = without_others([one.first_px for one in people.values()]) if people else ()
        for (name, one), lengths in zip(people.items(), left, strict=True):
            of[f"{name}{ending}"] = {**one.figures, "points_px": float(lengths.mean())}
    strangers = list(rows[""].values())
    shown = rows[""] | rows[" (tuned on)"]
    for title in ("median", "max") if strangers else ():
        columns = [Column(column.name, column.title, whole=title) for column in COLUMNS]
        shown[f"**strangers, {title}**"] = whole(columns, strangers)
    report.figures(part, COLUMNS, shown, {})
    return strangers


def _judge(
    report: Report, what: str, rows: Sequence[Figures], limits: Mapping[str, float], how: str = "median"
) -> None:
    title = {"max": "worst"}.get(how, how)
    for name, most in limits.items():
        report.judge(f"{what}: {name.replace('_', ', ')}, {title}", over(rows, name, how), most=most)


def _judge_honesty(people: Sequence[Judged], report: Report, what: str) -> None:
    """Compare the pooled intervals and confidences of all people with their targets."""
    frames = [one.figures["frames"] for one in people]
    for part in ("position", "rotation"):
        shares = [one.figures[f"{part}_inside"] for one in people]
        share = float(np.average(shares, weights=frames)) if people else None
        title = f"{what}: 90 % intervals hold, {part}"
        report.judge(title, share, least=0.75, most=0.97, digits=1, percent=True)
    area = None
    if people:
        wrong = np.concatenate([one.wrong for one in people])
        area = roc_area(np.concatenate([one.confidence for one in people]), ~wrong)
    title = f"{what}: confidence against rotation > {WRONG_DEG:g} deg, ROC area"
    report.judge(title, area, least=0.85, digits=3)


# One camera

EXPLAINED = (
    "Means of absolute errors over all frames in which the head was followed, after one constant rigid "
    "offset of the head's frame. Right depth factor: scale of the result that fits the truth best. "
    "First points: of the first followed frame on the image, less the mean offset of the other people. "
    "Tracked: share of frames that are not lost. Off: share of frames whose rotation is off by more than "
    f"{WRONG_DEG:g} deg. Inside: share of entries within the stated 90 % intervals, nothing removed."
)
MEDIAN = {"x_mm": 3.0, "y_mm": 3.0, "z_mm": 6.0, "roll_deg": 0.35, "pitch_deg": 1.0, "yaw_deg": 1.0}
WORST = {"x_mm": 6.0, "y_mm": 6.0, "z_mm": 10.0, "yaw_deg": 1.8}


def _mono_jobs(options: Options) -> Iterator[Job]:
    for person in options.everybody:
        name = f"{person.name}-mono"
        yield Job(name, (Step(f"runs/{name}.mcap", options.mono(person)),))


def _report_mono(options: Options, files: Files, report: Report) -> None:
    report.text("## One camera", EXPLAINED)
    rows = _report_people("mono", options, files, report)
    factors = values_of(rows, "factor")
    outside = float((np.abs(factors - 1.0) > 0.05).sum()) if len(factors) else None
    report.judge("one camera: depth factors outside 0.95 to 1.05", outside, most=1, digits=0)
    _judge(report, "one camera", rows, MEDIAN)
    _judge(report, "one camera", rows, WORST, "max")
    people = judged_people(options.strangers, "mono", files)
    left = without_others([one.first_px for one in people.values()]) if people else np.full((1, 1), np.nan)
    report.judge("one camera: first points, px, mean", float(left.mean()), most=2.5)
    report.judge("one camera: first points, px, 95 %", float(np.quantile(left, 0.95)), most=7.0)
    _judge_honesty([*judged_people(options.everybody, "mono", files).values()], report, "one camera")


# Given the size

DISTANCE, PERSON = "told-distance", "told-person"
STEREO_FROM = 60  # first frame of the stereo result that is used for --person


def pupil_distance_mm(truth: Path) -> float:
    """Return the distance between the eye centres in the first frame of the ground truth, mm."""
    eyes = heads.in_head(load_csv_track(truth, head_subject(heads.LEFT, 0)))[0, :4]
    return float(np.linalg.norm(eyes[2:].mean(axis=0) - eyes[:2].mean(axis=0)))


def _told_jobs(options: Options) -> Iterator[Job]:
    for person in options.strangers:
        name, distance = f"{person.name}-{DISTANCE}", f"{pupil_distance_mm(person / heads.TRUTH):.2f}"
        yield Job(name, (Step(f"runs/{name}.mcap", options.mono(person, "--interpupillary-mm", distance)),))
        name = f"{person.name}-{PERSON}"
        reading = heads.reading_arguments(person, options.output / "recordings")
        stereo = Step(f"runs/{name}-stereo.mcap", ("head", "stereo", *reading, "--start", str(STEREO_FROM)))
        mono = Step(f"runs/{name}.mcap", options.mono(person, "--person", FILE + stereo.output))
        yield Job(name, (stereo, mono))


def _report_told(options: Options, files: Files, report: Report) -> None:
    report.text("## One camera, the size of the head given", "With `--interpupillary-mm` from the truth:")
    rows = _report_people(DISTANCE, options, files, report)
    _judge(report, "given the distance of pupils", rows, {"x_mm": 1.0, "y_mm": 1.0, "z_mm": 4.0})
    report.text(f"With `--person`, the result of two cameras that saw the frames from {STEREO_FROM} on:")
    _report_people(PERSON, options, files, report)


# When the person is adjusted, and in how many passes

WAYS = {
    "never-1": ("never, one pass", ("--adjust", "never", *heads.FIRST)),
    "never-2": ("never, two passes", ("--adjust", "never", *heads.SECOND)),
    "start-1": ("at the start, one pass", ("--adjust", "start", *heads.FIRST)),
    "start-2": ("at the start, two passes", ("--adjust", "start", *heads.SECOND)),
    "always-1": ("always, one pass", ("--adjust", "always", *heads.FIRST)),
    "always-2": (
        "always, two passes",
        ("--adjust", "always", *heads.SECOND, "--set", "adjustment.whole=false"),
    ),
    "whole": ("always, then over the whole recording (default)", heads.SECOND),
}
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
PAIRED = {"position_mm": "position, mm", "z_mm": "z, mm", "rotation_deg": "rotation, deg"}
PAIRED |= {"pitch_deg": "pitch, deg", "yaw_deg": "yaw, deg"}
WAY_COLUMNS = tuple(
    Column(column.name, column.title, whole="median")
    for column in (
        *heads.POSE_COLUMNS,
        Column("rotation_deg", "rotation"),
        Column("position_mm", "position, mm"),
    )
)


def _adjusting_jobs(options: Options) -> Iterator[Job]:
    for person in options.strangers:
        for way, (_, arguments) in WAYS.items():
            name = f"{person.name}-{way}"
            yield Job(name, (Step(f"runs/{name}.mcap", options.mono(person, *arguments)),))


def _report_adjusting(options: Options, files: Files, report: Report) -> None:
    title = "## When the person is adjusted, and in how many passes"
    report.text(title, "Medians over the people, then pairs.")
    rows = {
        way: {
            one.name: figures
            for one in options.strangers
            if (figures := heads.mono_figures(files.made(f"runs/{one.name}-{way}.mcap"), one / heads.TRUTH))
        }
        for way in WAYS
    }
    titled = {title: list(rows[way].values()) for way, (title, _) in WAYS.items()}
    report.entrants("adjusting", WAY_COLUMNS, titled)
    chosen_pairs = {
        (f"{WAYS[first][0]} → {WAYS[second][0]}", title): pairs_of(rows[first], rows[second], name)
        for first, second in PAIRS
        for name, title in PAIRED.items()
    }
    report.pairs("adjusting, paired", ("", ""), chosen_pairs)


# Two cameras

STEREO_MEDIAN = {"x_mm": 0.25, "y_mm": 0.25, "z_mm": 0.5, "roll_deg": 0.3, "pitch_deg": 0.6, "yaw_deg": 0.6}


def _stereo_jobs(options: Options) -> Iterator[Job]:
    for person in options.everybody:
        reading, name = (
            heads.reading_arguments(person, options.output / "recordings"),
            f"{person.name}-stereo",
        )
        run = ("head", "stereo", *reading, "--passes", "2", "--timings")
        yield Job(name, (Step(f"runs/{name}.mcap", run),))


def _report_stereo(options: Options, files: Files, report: Report) -> None:
    report.text("## Two cameras, two passes")
    rows = _report_people("stereo", options, files, report)
    _judge(report, "two cameras", rows, STEREO_MEDIAN)
    _judge_honesty([*judged_people(options.everybody, "stereo", files).values()], report, "two cameras")


def _head(options: Options) -> Iterator[str]:
    yield "# Head trackers on strangers"
    names = ", ".join(folder.name for folder in options.strangers)
    models = "shipped models" if options.left_out is None else "models learned from the others"
    yield f"posetrack {version()}; strangers: {names}; one camera with {models}; {os.cpu_count()} cores."


STUDY = Study(
    "heads-strangers",
    Options,
    (
        Part("mono", _mono_jobs, _report_mono),
        Part("told", _told_jobs, _report_told),
        Part("adjusting", _adjusting_jobs, _report_adjusting),
        Part("stereo", _stereo_jobs, _report_stereo),
    ),
    _head,
    __doc__,
)
