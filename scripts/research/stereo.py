"""Reproduce experiment 3.4 of Sugano's thesis; measure the stereo head tracker on unseen faces."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from mcap.records import Metadata

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.build import version
from posetrack_cli.evaluation.measuring.head_metrics import HEAD_POSE
from posetrack_cli.evaluation.measuring.pose_metrics import distances
from posetrack_cli.head.config import HeadStereoConfig
from posetrack_cli.head.face.points import MOUTH, NOSTRILS, POINT_COUNT
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.results import load_arrays, read_result
from posetrack_cli.synthesis.recording import SYNTH_RECORD
from research import heads, plots
from research.heads import AXES, POSE_COLUMNS, TRUTH, Compared, compare, persons_in, reading_arguments
from research.report import Column, Figures, Report, over, pairs_of, values_of, whole
from research.runner import FILE, Files, Job, Step, command
from research.study import FIRST_SEED, FOLDER, HEADS, Part, Study, setting, unused_for_tuning

RIGID, PAPER = ("--model", "rigid"), ("--config", "head-stereo-paper")
# Title and arguments of ``posetrack head stereo`` by name
ENTRANTS: dict[str, tuple[str, tuple[str, ...]]] = {
    "deformable": ("deformable (default)", ()),
    "deformable-2": ("deformable, two passes", ("--passes", "2")),
    "rigid": ("rigid", RIGID),
    "rigid-2": ("rigid, two passes", (*RIGID, "--passes", "2")),
    "paper": ("`head-stereo-paper`, deformable", PAPER),
    "paper-rigid": ("`head-stereo-paper`, rigid", (*PAPER, *RIGID)),
}
# Number of first frames in which every model is rigid; deformable and rigid ones are compared after them
RIGID_FRAMES = HeadStereoConfig().model.rigid_frames
# Distance of a point from its neutral position above which it moves and the face deforms
MOVING_MM, DEFORMING_MM = 3.0, 1.0
WRONG = (10.0, 5.0)  # pose error, mm and deg, above which a frame is wrong
STEADY_S = 0.5  # time a head must be tracked to count as recovered
# Points whose true motion is visible; nostril openings hardly follow their vertices
FOLLOWED = np.setdiff1d(np.arange(POINT_COUNT), np.arange(POINT_COUNT)[NOSTRILS])
COLUMNS = (*POSE_COLUMNS, Column("mouth_mm", "mouth, mm"), *heads.TRACKED_COLUMNS)
EXPLAINED = (
    "Mean absolute errors over the frames that are reported as tracked, after one constant rigid offset of "
    "the head's frame (`eval --align rigid`). Mouth: corners of the mouth while they are more than 3 mm "
    "from their neutral place, in head coordinates, after each point's constant offset. First frame: the "
    "number, from 0, of the first one tracked; of several recordings the latest. Wrong: frames reported as "
    "tracked whose pose is off by more than 10 mm or 5 deg."
)
# Further arguments of ``posetrack head synth`` by name; the light drifts in all of them
CONDITIONS: dict[str, tuple[str, ...]] = {
    "slow light": (),
    "sudden light": ("--light", "sudden"),
    "occlusion": ("--occlusion",),
    "sudden turn": ("--motion", "turn"),
    "distortion": ("--lens-distortion",),
    "noise 2": ("--noise-factor", "2"),
    "speed 2": ("--speed", "2"),
    "missing images": ("--drops",),
}


@dataclass(frozen=True)
class Options:
    """Settings of the study."""

    output: Path
    heads: Path | None = setting("--heads", None, HEADS, type=FOLDER)  # noqa: RUF009
    identities: int = setting("--identities", 3, "Persons per condition.")
    frames: int = setting("--frames", 300, "Frames per recording of the conditions.", 60)
    experiment_frames: int = setting("--experiment-frames", 1800, "Frames of experiment 3.4.", 240)
    first_identity: int = setting(
        "--first-identity", FIRST_SEED, "Seed of the first person; smaller ones are for trials.", 0
    )
    conditions: tuple[str, ...] = setting(
        "--condition", (), "Only this; repeatable.", multiple=True, type=click.Choice(list(CONDITIONS))
    )

    @property
    def persons(self) -> range:
        """Seeds of the persons."""
        return range(self.first_identity, self.first_identity + self.identities)

    def names(self, condition: str) -> list[str]:
        """Return the names of the recordings of a condition."""
        return [f"{condition.replace(' ', '-')}-{person}-{self.frames}" for person in self.persons]

    @property
    def chosen(self) -> tuple[str, ...]:
        """Conditions to run."""
        return self.conditions or tuple(CONDITIONS)

    @property
    def experiments(self) -> list[str]:
        """Names of the recordings of experiment 3.4, one a person."""
        return [f"experiment-{person}-{self.experiment_frames}" for person in self.persons]


def _tracked(name: str, reading: tuple[str, ...], entrants: Iterable[str] = ENTRANTS) -> list[Step]:
    return [
        Step(f"runs/{name}-{entrant}.mcap", ("head", "stereo", *reading, *ENTRANTS[entrant][1], "--timings"))
        for entrant in entrants
    ]


def _synthetic(name: str, person: int, frames: int, *more: str, entrants: Iterable[str] = ENTRANTS) -> Job:
    """Return the job of a synthetic recording, which is kept since rendering takes most of the time."""
    seeds = ("--identity", str(person), "--seed", str(person))
    drawn = Step(f"recordings/{name}.mcap", ("head", "synth", *seeds, "--frames", str(frames), *more))
    return Job(name, (drawn, *_tracked(name, (FILE + drawn.output,), entrants)))


# Measuring


def course(result: Path, truth: Path | None) -> Compared:
    """Compare a result with ground truth after removing a rigid offset and an offset per point."""
    return compare(result, truth, "rigid+points")


def wrong(one: Compared) -> BoolArray:
    """Return (M,) whether the pose is wrong."""
    found: BoolArray = (one.position_mm > WRONG[0]) | (one.rotation_deg > WRONG[1])
    return found


def stereo_figures(one: Compared, event_end_s: float | None) -> dict[str, float]:
    """Return the figures of a result, omitting those without data.

    Means are over tracked frames; ``deforming`` and ``still`` ones over frames after the first
    ``RIGID_FRAMES`` whose true face is deformed or neutral. Recovery counts from ``event_end_s``, if any.
    """
    moved, points = one.moved_mm, distances(one.shape, one.true_shape)
    deforming = moved[:, FOLLOWED].max(axis=1) > DEFORMING_MM
    later = np.arange(len(deforming)) >= RIGID_FRAMES
    found = heads.figures_of(one, one.believed, WRONG)
    for begin, rows in (("", True), ("deforming ", later & deforming), ("still ", later & ~deforming)):
        chosen = one.believed & rows
        if chosen.any():
            means = heads.figures_of(one, chosen, WRONG)
            found |= {f"{begin}{name}": means[name] for name in (*HEAD_POSE, "position_mm", "rotation_deg")}
        for name, columns in (("mouth_mm", np.arange(POINT_COUNT)[MOUTH]), ("moving_mm", FOLLOWED)):
            values = points[:, columns][(chosen[:, None] & (moved > MOVING_MM))[:, columns]]
            if values.size:
                found[f"{begin}{name}"] = float(values.mean())
    if event_end_s is not None and event_end_s <= one.seconds[-1]:
        found["recovery_s"] = recovery_s(one, event_end_s)
    return found


def recovery_s(one: Compared, end_s: float) -> float:
    """Return the time from ``end_s`` until the head is tracked correctly for ``STEADY_S`` or until the end.

    Infinite if it is not recovered.
    """
    right = one.believed & ~wrong(one)
    for begin in one.seconds[one.seconds >= end_s]:
        if right[(one.seconds >= begin) & (one.seconds <= begin + STEADY_S)].all():
            return float(begin - end_s)
    return float("inf")


def event_end_s(recording: Path) -> float | None:
    """Return the end of turns and occlusions in a synthetic recording, from its record; None without any."""
    if not recording.is_file():
        return None
    records = (record for record in McapFile(recording).extras() if isinstance(record, Metadata))
    found = next((record.metadata for record in records if record.name == SYNTH_RECORD), {})
    ends = [float(text.split()[1]) for name in ("turn_s", "occlusion_s") if (text := found.get(name, ""))]
    return max(ends, default=None)


def _measured(options: Options, files: Files, name: str) -> dict[str, Figures]:
    """Return the figures of the results of a recording by entrant."""
    truth = None if options.heads is None else options.heads / name / TRUTH
    known = truth if truth is not None and truth.exists() else None
    end_s = event_end_s(options.output / f"recordings/{name}.mcap")
    results = {entrant: files.made(f"runs/{name}-{entrant}.mcap") for entrant in ENTRANTS}
    return {e: stereo_figures(course(path, known), end_s) for e, path in results.items() if path is not None}


def _report_accuracy(report: Report, part: str, found: list[dict[str, Figures]]) -> None:
    """Add one row per entrant, averaged over recordings."""
    rows = {title: [one[way] for one in found if way in one] for way, (title, _) in ENTRANTS.items()}
    report.entrants(part, COLUMNS, rows)


# Recordings of other faces

# Targets for ``HEAD_POSE`` and the mouth corners by entrant
LIMITS = {
    "deformable": ("one pass", (0.3, 0.3, 0.6, 0.25, 0.6, 0.6, 2.5)),
    "deformable-2": ("two", (0.2, 0.2, 0.4, None, 0.5, 0.5, 2.0)),
}


def _people_jobs(options: Options) -> Iterator[Job]:
    for person in persons_in(options.heads):
        reading = reading_arguments(person, options.output / "recordings")
        yield Job(person.name, tuple(_tracked(person.name, reading)))


def _report_people(options: Options, files: Files, report: Report) -> None:
    report.text("## Recordings of other faces, automatic start", EXPLAINED)
    for person in persons_in(options.heads):
        report.text(f"### {person.name}")
        found = _measured(options, files, person.name)
        _report_accuracy(report, person.name, [found])
        for entrant, (passes, limits) in LIMITS.items():
            for name, most in zip((*HEAD_POSE, "mouth_mm"), limits, strict=True):
                if most is not None:
                    value = found.get(entrant, {}).get(name)
                    report.judge(f"{person.name}, {passes}: {name.replace('_', ', ')}", value, most=most)


# Synthetic recordings: people never used for tuning, one difficulty at a time


def _conditions_jobs(options: Options) -> Iterator[Job]:
    for condition in options.chosen:
        for person, name in zip(options.persons, options.names(condition), strict=True):
            yield _synthetic(name, person, options.frames, *CONDITIONS[condition])


def _report_conditions(options: Options, files: Files, report: Report) -> None:
    report.text(
        "## Synthetic recordings, automatic start",
        f"{options.identities} persons of {options.frames} frames per condition: faces deform in the first "
        "two thirds, light drifts slowly. Found again: seconds from the moment when an object has left the "
        "face, or the second of two turns of 200 deg/s has ended, to the first frame from which on the head "
        "is tracked within 10 mm and 5 deg for half a second.",
    )
    found = {name: [_measured(options, files, one) for one in options.names(name)] for name in options.chosen}
    for condition, of in found.items():
        report.text(f"### {condition.capitalize()}")
        _report_accuracy(report, condition, of)
    again = (Column("recovery_s", "mean, s"), Column("longest_s", "longest, s", whole="max"))
    for condition in ("occlusion", "sudden turn"):
        rows = {}
        for entrant, (title, _) in ENTRANTS.items():
            known = [one[entrant] for one in found.get(condition, []) if "recovery_s" in one.get(entrant, {})]
            rows[title] = [{**one, "longest_s": one["recovery_s"]} for one in known]
        report.text(f"### Found again: {condition}")
        report.entrants(f"found again, {condition}", again, rows)
        longest = over(rows[ENTRANTS["deformable"][0]], "longest_s", "max")
        report.judge(f"{condition}: found again, s, longest", longest, most=0.5)
    for entrant in LIMITS:
        of_entrant = [one[entrant] for of in found.values() for one in of if entrant in one]
        count, total = (over(of_entrant, name, "sum") for name in ("wrong", "frames"))
        report.judge(f"{entrant}: wrong poses reported as tracking, of {total}", count, most=0, digits=0)


# Deformable against rigid, second pass against first

COMPARED = {
    "deforming pitch_deg": "deforming: pitch, deg",
    "deforming moving_mm": "deforming: moving points, mm",
    "still pitch_deg": "neutral: pitch, deg",
    "still rotation_deg": "neutral: rotation, deg",
    "still position_mm": "neutral: position, mm",
}
REPEATED = {"position_mm": "position, mm", "rotation_deg": "rotation, deg", "mouth_mm": "mouth, mm"}


def _comparison_jobs(options: Options) -> Iterator[Job]:
    yield from (*_people_jobs(options), *_conditions_jobs(options))


def _report_comparison(options: Options, files: Files, report: Report) -> None:
    report.text(
        "## Deformable against rigid model, and a second pass",
        f"Pairs are recordings. Frames after the first {RIGID_FRAMES}, before which both models are rigid. "
        "Deforming: the true face is not neutral; moving points: eyes, mouth and brows while they are more "
        "than 3 mm from their neutral places. Ratio: median of second over first.",
    )
    names = [person.name for person in persons_in(options.heads)]
    names += [name for condition in options.chosen for name in options.names(condition)]
    found = {name: _measured(options, files, name) for name in names}
    rows = {}
    for first, second, metrics in (
        ("rigid", "deformable", COMPARED),
        ("deformable", "deformable-2", REPEATED),
    ):
        of = [{name: one[way] for name, one in found.items() if way in one} for way in (first, second)]
        for metric, title in metrics.items():
            pairs = rows[f"{first} → {second}", title] = pairs_of(of[0], of[1], metric)
            if first == "rigid" and title.startswith("deforming"):
                ratio = float(np.median(pairs[:, 1] / pairs[:, 0])) if len(pairs) else None
                report.judge(f"{title}: of the rigid model's, median", ratio, most=0.5)
            else:
                ratio = float(pairs[:, 1].mean() / pairs[:, 0].mean()) if len(pairs) else None
                report.judge(f"{title}: {second} over {first}, means", ratio, most=1.05)
    report.pairs("comparison", ("", ""), rows)


# Experiment 3.4

SETTLED_FRAMES = 600  # by this frame the contribution ratio has recovered, according to the thesis
# The thesis's statements, in our words
THESIS = {
    "deforming": "From frame 121 to about frame 1200, while the face deforms, the two estimates clearly "
    "differ; the pictures show that those of the deformable model are the right ones (3.4, figures 3.9 and "
    "3.10).",
    "rigid": "Over the remaining 600 frames or so the two nearly coincide: the deformable model follows "
    "rigid motion without needless deformation (3.4, figure 3.10).",
    "contribution": "The cumulative contribution ratio of the five components drops sharply once, right "
    "after tracking begins, and is back near 80 % after some 600 frames, 20 s, of learning (3.4, figure "
    "3.10).",
}
MODELS = {"head-stereo": ("rigid", "deformable"), "head-stereo-paper": ("paper-rigid", "paper")}


def _experiment_jobs(options: Options) -> Iterator[Job]:
    entrants = [way for pair in MODELS.values() for way in pair]
    for name, person in zip(options.experiments, options.persons, strict=True):
        yield _synthetic(name, person, options.experiment_frames, entrants=entrants)


def spans(frames: int) -> dict[str, BoolArray]:
    """Return the rows (N,) of the two parts that the thesis compares: deforming to two thirds, then rigid."""
    rows, end = np.arange(frames), round(2 / 3 * frames)
    return {"deforming": (rows >= RIGID_FRAMES) & (rows < end), "rigid": rows >= end}


def picture_frames(one: Compared, parts: Mapping[str, BoolArray]) -> list[int]:
    """Return the greatest deformation in each third of the deforming part, and the middle of the other."""
    thirds, moved = (
        np.array_split(np.flatnonzero(parts["deforming"]), 3),
        one.moved_mm[:, FOLLOWED].max(axis=1),
    )
    chosen = [int(of[np.argmax(moved[of])]) for of in thirds if of.size]
    return [*chosen, int(np.median(np.flatnonzero(parts["rigid"])))]


def contribution_ratio(result: Path) -> FloatArray:
    """Return the cumulative contribution ratio (N,) that a result states, NaN before anything is learned."""
    column = read_result(result).subject.number_names.index("contribution_ratio")
    ratio: FloatArray = load_arrays(result)["numbers"][:, column]
    return ratio


def contribution_text(ratio: FloatArray) -> str:
    """Return when learning begins, when the ratio is lowest, and whether it comes back."""
    known = np.flatnonzero(np.isfinite(ratio))
    if not known.size:
        return "Ours: nothing was learned."
    lowest, after = known[np.argmin(ratio[known])], min(int(known[0]) + SETTLED_FRAMES, len(ratio) - 1)
    return (
        f"Ours: learning begins in frame {known[0]}; lowest {ratio[lowest]:.0%} in frame {lowest}; "
        f"{ratio[after]:.0%} in frame {after}; {ratio[-1]:.0%} in the end."
    )


def _moving(one: Compared, rows: BoolArray | slice = slice(None)) -> tuple[FloatArray, float]:
    """Return the mean error (M,) of points away from their neutral places, NaN without any, and its mean."""
    moving = one.moved_mm[rows][:, FOLLOWED] > MOVING_MM
    errors = np.where(moving, distances(one.shape, one.true_shape)[rows][:, FOLLOWED], 0.0)
    count = moving.sum(axis=1)
    whole = float(errors.sum() / count.sum()) if count.sum() else float("nan")
    return np.where(count > 0, errors.sum(axis=1) / np.maximum(count, 1), np.nan), whole


def _report_experiment(options: Options, files: Files, report: Report) -> None:
    report.text(
        "## Experiment 3.4: rigid and deformable model",
        f"{options.experiment_frames} frames of each of {len(options.persons)} synthetic heads: the face "
        "deforms for two thirds, then only the head moves. The first "
        f"{RIGID_FRAMES} frames are tracked with a rigid model in any case. Figures show the first head; "
        "tables are means over the heads.",
    )
    for title, pair in MODELS.items():
        results = []
        for name in options.experiments:
            paths = [files.made(f"runs/{name}-{way}.mcap") for way in pair]
            known = {model: path for model, path in zip(("rigid", "deformable"), paths, strict=True) if path}
            if len(known) == len(pair):
                results.append((name, known))
        if results:
            _report_models(options, report, title, results)
    report.text("### Over the whole recording", EXPLAINED)
    found = [_measured(options, files, name) for name in options.experiments]
    _report_accuracy(report, "experiment", found)
    times = {way: values_of([one[way] for one in found if way in one], "ms") for way in ENTRANTS}
    report.text(
        "Thesis: 30 frames per second with 1000 particles on a Pentium 4, 3.0 GHz (3.4). Ours, median "
        "milliseconds of tracking per frame on one core: "
        + ", ".join(f"{way} {np.median(ms):.1f}" for way, ms in times.items() if len(ms))
    )


def _report_models(
    options: Options, report: Report, title: str, results: Sequence[tuple[str, Mapping[str, Path]]]
) -> None:
    """Add figures 3.9 and 3.10 of a configuration, and the thesis's statements with our figures."""
    ending = "" if title == "head-stereo" else "-paper"
    every = [{model: course(path, None) for model, path in paths.items()} for _, paths in results]
    ratios = [contribution_ratio(paths["deformable"]) for _, paths in results]
    parts = spans(len(ratios[0]))
    (name, paths), courses = results[0], every[0]
    picture, graph = (options.output / f"figure{number}{ending}.png" for number in ("3.9", "3.10"))
    frames = ",".join(map(str, picture_frames(courses["deformable"], parts)))
    recording = options.output / f"recordings/{name}.mcap"
    shown = ("--recording", str(recording), "--select", frames, "--crop", "head", "--overwrite")
    command("view", *map(str, paths.values()), "-o", str(picture), *shown)
    draw_poses(graph, courses, ratios[0], [RIGID_FRAMES, int(np.flatnonzero(parts["rigid"])[0])])
    report.text(f"### `{title}`", "Figure 3.9: both cameras, rigid model above, deformable model below.")
    report.picture(picture, "Poses and points of both models on the images")
    report.text("Figure 3.10: poses, and on the right the errors of both.")
    report.picture(graph, "Pose over time and contribution ratio")
    columns = (*POSE_COLUMNS, Column("moving_mm", "moving points, mm"))
    for part, rows in parts.items():
        people = [_of_person(courses, rows) for courses in every]
        found = {row: whole(columns, [person[row] for person in people]) for row in people[0]}
        report.text(f"> **Thesis:** {THESIS[part]}")
        report.figures(f"{title}, {part}", columns, found, {})
    report.text(f"> **Thesis:** {THESIS['contribution']}", *map(contribution_text, ratios))


def _of_person(courses: Mapping[str, Compared], rows: BoolArray) -> dict[str, dict[str, float]]:
    """Return how far the two models are apart over some rows (N,), and the errors of each."""
    apart = np.abs(courses["deformable"].columns - courses["rigid"].columns)[rows].mean(axis=0)
    found = {"rigid and deformable, apart by": dict(zip(HEAD_POSE, apart.tolist(), strict=True))}
    for model, one in courses.items():
        means = dict(zip(HEAD_POSE, one.pose[rows].mean(axis=0).tolist(), strict=True))
        found[f"error of the {model} model"] = means | {"moving_mm": _moving(one, rows)[1]}
    return found


def draw_poses(path: Path, courses: Mapping[str, Compared], ratio: FloatArray, marks: list[int]) -> None:
    """Draw figure 3.10: six components and the contribution ratio (N,); next to them the errors.

    Marked are the first frame with a deformable model and the first one of rigid motion.
    """
    numbers = {name: np.arange(len(one.pose)) for name, one in courses.items()}
    panels = []
    for column, label in enumerate(AXES):
        values = {"truth": (numbers["deformable"], courses["deformable"].true_columns[:, column])}
        values |= {name: (numbers[name], one.columns[:, column]) for name, one in courses.items()}
        errors = {name: (numbers[name], one.pose[:, column]) for name, one in courses.items()}
        panels.append([plots.Panel(label, values), plots.Panel(f"error: {label}", errors)])
    moving = {name: (numbers[name], _moving(one)[0]) for name, one in courses.items()}
    shares = {"deformable": (np.arange(len(ratio)), ratio)}
    panels.append([plots.Panel("contribution ratio", shares), plots.Panel("moving points, mm", moving)])
    plots.over_time(path, panels, "frame", marks)


def thesis_head(title: str, chapter: int, tracker: str, persons: range) -> Iterator[str]:
    """Yield the begin of a report on a chapter of the thesis."""
    yield f"# {title}"
    yield (
        "Sugano, *User-independent techniques for real-time estimation of non-rigid 3D head motion* (2007), "
        f"chapter {chapter}, by posetrack {version()}. Synthetic persons {persons[0]} to "
        f"{persons[-1]}{unused_for_tuning(persons[0])}; {os.cpu_count()} cores."
    )
    yield (
        f"`{tracker}` is our default; `{tracker}-paper` is the thesis's method as printed, as far as there "
        "are keys (`docs/method.md` lists the deviations)."
    )


STUDY = Study(
    "stereo",
    Options,
    (
        Part("people", _people_jobs, _report_people),
        Part("conditions", _conditions_jobs, _report_conditions),
        Part("comparison", _comparison_jobs, _report_comparison),
        Part("experiment", _experiment_jobs, _report_experiment),
    ),
    lambda options: thesis_head(
        "Head pose and face deformation from two cameras", 3, "head-stereo", options.persons
    ),
    __doc__,
    {"identities": 1, "frames": 150, "experiment_frames": 240, "conditions": ("slow light", "occlusion")},
)
