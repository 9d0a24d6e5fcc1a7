"""Reproduce experiments A, B and C of Sugano's thesis; measure the one-camera head tracker on other faces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.measuring.evaluate import Alignment
from posetrack_cli.evaluation.measuring.head_metrics import HEAD_POSE
from posetrack_cli.evaluation.reading.tracks import Track, track_of_result
from posetrack_cli.geometry import rotations
from posetrack_cli.results.reader import read_result
from research import heads, plots
from research.report import Column, Figures, Report, pairs_of
from research.runner import FILE, Files, Job, Step, command
from research.stereo import thesis_head
from research.study import FIRST_SEED, FOLDER, HEADS, Part, Study, setting

MODEL_PEOPLE, PEOPLE = 11, 6  # S of the thesis; and with six pairs Wilcoxon's test can find a difference
# In shorter recordings the two motions are too fast for the stereo tracker, and no model can be built
LEAST_MOTION_FRAMES = 240
MOTIONS_SEED = 1000  # added to a person's seed, so that the recordings of a person are independent
PAPER = ("--config", "head-mono-paper")
# Kinds of alignment, and their values of ``posetrack eval --align``
WAYS: dict[str, Alignment] = {
    "as measured": "rigid",
    "depth factor removed": "similarity",
    "nothing removed": "none",
}
EXPLAINED = (
    "Mean absolute errors over the frames in which the head was followed, after one constant rigid offset "
    "of the head's frame (`eval --align rigid`). Depth factor removed: also one common factor on all "
    "lengths, which one camera cannot see. Nothing removed: not even the offset, which absorbs the constant "
    "part of an error in z and causes errors in x and y when the head turns. Tracked: share of frames that "
    "are not lost. First frame: the number, from 0, of the first one followed; of several recordings the "
    "latest. Wrong: frames followed whose pose is off by more than 60 mm or 15 deg."
)
COLUMNS = (*heads.POSE_COLUMNS, *heads.TRACKED_COLUMNS)
FACTOR_COLUMNS = (*COLUMNS, Column("factor", "depth factor", 4), Column("ms", "ms", 1))


@dataclass(frozen=True)
class Options:
    """Settings of the study."""

    output: Path
    heads: Path | None = setting("--heads", None, HEADS, type=FOLDER)  # noqa: RUF009
    clips: Path | None = setting("--clips", None, "Folder of videos of faces.", type=FOLDER)  # noqa: RUF009
    people: int = setting(
        "--people", PEOPLE, "Test persons, the first of those that the model is built from."
    )
    model_people: int = setting("--model-people", MODEL_PEOPLE, "Persons that the model is built from.", 6)
    frames: int = setting("--frames", 1800, "Frames per test recording.", 60)
    motion_frames: int = setting(
        "--motion-frames", 420, "Frames per recording of the model's two motions.", LEAST_MOTION_FRAMES
    )
    first_identity: int = setting(
        "--first-identity", FIRST_SEED, "Seed of the first person; smaller ones are for trials.", 0
    )

    def __post_init__(self) -> None:
        if self.people > self.model_people:
            modelled = f"only {self.model_people} are in the model (--model-people)"
            raise click.UsageError(f"--people {self.people}: {modelled}")

    @property
    def persons(self) -> range:
        """Seeds of the test persons."""
        return range(self.first_identity, self.first_identity + self.people)

    @property
    def modelled(self) -> range:
        """Seeds of the persons in the model."""
        return range(self.first_identity, self.first_identity + self.model_people)

    def test(self, person: int) -> str:
        """Return the name of a person's test recording."""
        return f"test-{person}-{self.frames}"


class Entrant(NamedTuple):
    """A way to track with one camera."""

    title: str
    arguments: tuple[str, ...]  # of ``posetrack head mono``
    model: str = "shipped"  # or built from ``all`` persons, or from all ``others``


ADJUSTED = {when: ("--adjust", when) for when in ("always", "start", "never")}
# The thesis's experiments: model, and when the face is adjusted (4.5)
EXPERIMENTS = {"A": ("all", "always"), "B": ("others", "always"), "C": ("all", "start")}
# For recordings of the synthetic persons
POPULATION = {
    f"{name}{ending}": Entrant(f"{name}, {title}", (*first, *ADJUSTED[when], *passes), model)
    for name, (model, when) in EXPERIMENTS.items()
    for ending, title, first, passes in (
        ("", "one pass", (), heads.FIRST),
        ("-2", "two passes", (), heads.SECOND),
        ("-paper", "`head-mono-paper`", PAPER, heads.FIRST),
    )
} | {
    "never": Entrant("never adjusted, one pass", (*ADJUSTED["never"], *heads.FIRST), "all"),
    "never-2": Entrant("never adjusted, two passes", (*ADJUSTED["never"], *heads.SECOND), "all"),
    "shipped": Entrant("shipped model, one pass", heads.FIRST),
    "shipped-2": Entrant("shipped model, two passes", heads.SECOND),
}
OTHER_FACES = {
    "always": Entrant("adjusted always, one pass", heads.FIRST),
    "always-2": Entrant("adjusted always, two passes (default)", heads.SECOND),
    "start": Entrant("adjusted at the start, one pass", (*ADJUSTED["start"], *heads.FIRST)),
    "start-2": Entrant("adjusted at the start, two passes", (*ADJUSTED["start"], *heads.SECOND)),
    "never": Entrant("never adjusted, one pass", (*ADJUSTED["never"], *heads.FIRST)),
    "never-2": Entrant("never adjusted, two passes", (*ADJUSTED["never"], *heads.SECOND)),
    "paper": Entrant("`head-mono-paper`", (*PAPER, *heads.FIRST)),
}
OF_CLIPS = {
    "one-pass": Entrant("one pass", heads.FIRST),
    "two-passes": Entrant("two passes (default)", heads.SECOND),
    "paper": Entrant("`head-mono-paper`", (*PAPER, *heads.FIRST)),
}


# Recordings of other faces with ground truth, left camera only


def _people_jobs(options: Options) -> Iterator[Job]:
    for person in heads.persons_in(options.heads):
        reading = heads.reading_arguments(person, options.output / "recordings")
        alone = ("head", "mono", *reading, "--cameras", heads.LEFT, "--timings")
        steps = (
            Step(f"runs/{person.name}-{name}.mcap", (*alone, *entrant.arguments))
            for name, entrant in OTHER_FACES.items()
        )
        yield Job(person.name, tuple(steps))


def _report_people(options: Options, files: Files, report: Report) -> None:
    report.text("## Recordings of other faces, left camera alone", f"The shipped model. {EXPLAINED}")
    aims = dict(zip(HEAD_POSE, (1.3, 1.6, 4.8, 0.22, 1.2, 1.2), strict=True))
    for person in heads.persons_in(options.heads):
        results = {name: files.made(f"runs/{person.name}-{name}.mcap") for name in OTHER_FACES}
        for title, align in WAYS.items():
            found = {
                name: heads.mono_figures(path, person / heads.TRUTH, align) for name, path in results.items()
            }
            report.text(f"### {person.name}, {title}")
            rows = {entrant.title: found[name] for name, entrant in OTHER_FACES.items() if found[name]}
            report.figures(f"{person.name}, {title}", FACTOR_COLUMNS, rows, {})
            if align == "rigid":
                for name, passes in (("always", "one pass"), ("always-2", "two passes")):
                    for metric, aim in aims.items():
                        what = f"{person.name}, {passes}: {metric.replace('_', ', ')} (half of table 4.1)"
                        report.judge(what, found[name].get(metric), most=aim)


# Videos of real faces without ground truth

VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".webm")
# Rotation between two frames that counts as a flip of the pose: 600 deg/s at 30 Hz
FLIP_DEG = 20.0
CLIP_COLUMNS = (
    Column("frames", "frames", 0),
    Column("tracked", "tracked", 1, percent=True),
    Column("doubted", "lost frames", 0),
    Column("flips", "flips", 0),
    *(Column(name, f"jitter {title}", 3) for name, title in zip(HEAD_POSE, heads.AXES, strict=True)),
)


def clips_in(options: Options) -> list[Path]:
    """Return the videos of the folder."""
    found = [] if options.clips is None else sorted(options.clips.iterdir())
    return [path.resolve() for path in found if path.suffix.lower() in VIDEOS]


def _clips_jobs(options: Options) -> Iterator[Job]:
    for clip in clips_in(options):
        steps = [
            Step(f"runs/{clip.stem}-{name}.mcap", ("head", "mono", str(clip), *entrant.arguments))
            for name, entrant in OF_CLIPS.items()
        ]
        shown = ("--recording", str(clip), "--select", "spread:8", "--crop", "head")
        steps.append(Step(f"{clip.stem}.png", ("view", f"{FILE}runs/{clip.stem}-two-passes.mcap", *shown)))
        yield Job(clip.stem, tuple(steps))


def clip_figures(track: Track) -> dict[str, float]:
    """Return the share of tracked frames, the numbers of lost frames and flips, and the jitter.

    The jitter of a pose component is the RMS of (p- - 2 p + p+) / sqrt 6 over triples of tracked frames: the
    standard deviation of white noise on motion with constant velocity. NaN without triples.
    """
    lost = np.zeros(len(track), dtype=np.bool_) if track.lost is None else track.lost
    columns, tracked = heads.pose_columns(track), ~lost
    assert track.quaternion is not None
    turned = np.degrees(rotations.angle_between(track.quaternion[:-1], track.quaternion[1:]))
    three = tracked[:-2] & tracked[1:-1] & tracked[2:]
    second = (columns[:-2] - 2.0 * columns[1:-1] + columns[2:])[three] / np.sqrt(6.0)
    jitter = np.sqrt(np.mean(second**2, axis=0)) if len(second) else np.full(6, np.nan)
    return {
        "frames": float(len(track)),
        "tracked": float(tracked.mean()),
        "doubted": float(lost.sum()),
        "flips": float((turned > FLIP_DEG)[tracked[:-1] & tracked[1:]].sum()),
        **dict(zip(HEAD_POSE, jitter.tolist(), strict=True)),
    }


def _report_clips(options: Options, files: Files, report: Report) -> None:
    report.text(
        "## Videos of real faces, no truth",
        "Jitter: root mean square of second differences over frames in a row, divided by sqrt 6, which is "
        "the deviation of white noise on a motion of constant velocity. Flips: turns by more than "
        f"{FLIP_DEG:g} deg from one frame to the next. The cameras are unknown, so all lengths rest on a "
        "guess.",
    )
    rows = {}
    for clip in clips_in(options):
        for name, entrant in OF_CLIPS.items():
            path = files.made(f"runs/{clip.stem}-{name}.mcap")
            if path is not None:
                track = track_of_result(read_result(path), path.stem)
                rows[f"{clip.stem}, {entrant.title}"] = clip_figures(track)
    report.figures("clips", CLIP_COLUMNS, rows, {})
    for title, found in rows.items():
        if "paper" not in title:
            report.judge(f"{title}: frames tracked", found["tracked"], least=0.99, digits=1, percent=True)
            report.judge(f"{title}: flips of the pose", found["flips"], most=0, digits=0)
    for clip in clips_in(options):
        picture = files.made(f"{clip.stem}.png")
        if picture is not None:
            report.picture(picture, f"Points and axes on frames of {clip.stem}")


# Synthetic persons: recordings, models built from two cameras, one camera


def _recorded(name: str, *arguments: str) -> Job:
    """Return the job that generates a recording and tracks it in two passes of the stereo tracker."""
    drawn = Step(f"recordings/{name}.mcap", ("head", "synth", *arguments))
    return Job(name, (drawn, Step(_stereo(name), ("head", "stereo", FILE + drawn.output, "--passes", "2"))))


def _stereo(name: str) -> str:
    return f"runs/{name}-stereo.mcap"


def _mono(options: Options, person: int, entrant: str) -> str:
    return f"runs/{options.test(person)}-{entrant}.mcap"


def population_jobs(options: Options) -> Iterator[Job]:
    """Yield the jobs for the recordings, models and results of the synthetic persons."""
    motions = {person: f"motions-{person}-{options.motion_frames}" for person in options.modelled}
    for person, name in motions.items():
        seeds = ("--identity", str(person), "--seed", str(MOTIONS_SEED + person))
        script = ("--frames", str(options.motion_frames), "--script", "two-motions", "--motion", "slight")
        yield _recorded(name, *seeds, *script)
    first, last = options.modelled[0], options.modelled[-1]
    models: dict[int | None, str] = {None: f"models/face-{first}-{last}.npz"}
    models |= {person: f"models/face-{first}-{last}-without-{person}.npz" for person in options.persons}
    for without, model in models.items():
        results = (FILE + _stereo(name) for person, name in motions.items() if person != without)
        yield Job(model, (Step(model, ("head", "build-model", *results)),))
    for person in options.persons:
        name = options.test(person)
        yield _recorded(
            name, "--identity", str(person), "--seed", str(person), "--frames", str(options.frames)
        )
        steps = []
        for way, entrant in POPULATION.items():
            model = models[None if entrant.model == "all" else person]
            face = () if entrant.model == "shipped" else ("--face-model", FILE + model)
            reading = ("head", "mono", f"{FILE}recordings/{name}.mcap", "--cameras", heads.LEFT)
            steps.append(
                Step(_mono(options, person, way), (*reading, *face, *entrant.arguments, "--timings"))
            )
        yield Job(f"{name}, one camera", tuple(steps))


# Experiments A, B and C: one camera against two, for one person

TITLES = {
    "A": "A: the person is in the model",
    "B": "B: the person is not in the model",
    "C": "C: adjusted at the start only",
}
# Statements of the thesis, paraphrased
SAID = {
    "A": "x, y and roll nearly agree with the estimates of two cameras; z, pitch and yaw, which are harder "
    "for one camera, are accurate, too. In head coordinates the points are 5.9 mm off on average, and "
    "deformations make no great errors (4.5 A).",
    "B": "The errors are larger than for a person who was learnt, most visibly in z, but accuracy does not "
    "break down: the model's own approximation error acts on the pose (4.5 B).",
    "C": "Without adjustment after each frame the estimates are much less stable, most visibly in z, of "
    "whose error mean and standard deviation grow (4.5 C).",
}
# Mean and standard deviation of the absolute errors by experiment, mm and deg (tables 4.1 to 4.3)
THESIS = {
    "A": ((2.60, 3.12, 9.56, 0.43, 2.45, 2.33), (2.24, 1.73, 9.69, 0.31, 2.08, 1.95)),
    "B": ((3.73, 1.92, 17.85, 0.43, 3.07, 2.49), (2.57, 1.47, 9.37, 0.32, 2.31, 1.96)),
    "C": ((2.71, 3.43, 11.38, 0.43, 2.52, 2.26), (2.11, 2.03, 11.43, 0.32, 2.03, 2.02)),
}
THESIS_POINTS_MM = 5.9  # mean error of the feature points in head coordinates, experiment A (4.5 A)
# Whether the stereo result is the reference, and the alignment
AGAINST: dict[str, tuple[bool, Alignment]] = {
    "two cameras": (True, "rigid"),
    "two cameras, depth factor removed": (True, "similarity"),
    "two cameras, nothing removed": (True, "none"),
    "truth": (False, "rigid"),
    "truth, depth factor removed": (False, "similarity"),
}
SPREAD_COLUMNS = tuple(Column(one.name, one.title, spread=True) for one in heads.POSE_COLUMNS)


def _report_experiments(options: Options, files: Files, report: Report) -> None:
    person, first, last = options.persons[0], options.modelled[0], options.modelled[-1]
    report.text(
        "## Experiments A, B and C (4.5)",
        f"S = {options.model_people} synthetic persons ({first} to {last}) make the two motions in front of "
        "two cameras; `head build-model` takes A = 10 shapes of each from the stereo tracker's second pass. "
        f"Person {person} is then seen for {options.frames} frames of natural motion with all expressions. "
        "The reference is the second pass of two cameras, as in the thesis; the left camera alone is "
        "tracked. Mean ± standard deviation of absolute errors, after one constant rigid offset of the "
        "head's frame; the thesis does not say whether it removed one. The thesis's figures are of one real "
        "person, ours of one synthetic one.",
    )
    stereo = files.made(_stereo(options.test(person)))
    results = {name: files.made(_mono(options, person, name)) for name in POPULATION}
    if stereo is None or any(results[name] is None for name in EXPERIMENTS):
        report.text("Not measured: a result is missing.")
        return
    found = {name: heads.mono_figures(results[name], stereo) for name in EXPERIMENTS}
    for (experiment, title), table in zip(TITLES.items(), ("4.1", "4.2", "4.3"), strict=True):
        report.text(
            f"### {title}", f"> **Thesis:** {SAID[experiment]}", f"Table {table}; ours with one pass first:"
        )
        mean, sd = (dict(zip(HEAD_POSE, values, strict=True)) for values in THESIS[experiment])
        rows: dict[str, Figures] = {"thesis": mean | {f"{name} sd": value for name, value in sd.items()}}
        for name, entrant in POPULATION.items():
            if name.split("-")[0] == experiment:
                for against, (two_cameras, align) in AGAINST.items():
                    figures = heads.mono_figures(results[name], stereo if two_cameras else None, align)
                    rows[f"{entrant.title}, against {against}"] = figures
        report.figures(f"experiment {experiment}", SPREAD_COLUMNS, rows, {})
        for name, limit in mean.items():
            value = found[experiment].get(name)
            report.judge(
                f"{experiment}, one pass, against two cameras: {name.replace('_', ', ')}", value, most=limit
            )
    own = heads.mono_figures(stereo, None)
    report.text("### In addition")
    report.figures("two cameras", heads.POSE_COLUMNS, {"two cameras against the truth": own}, {})
    one = found["A"]
    report.text(
        f"The depth factor that A would need: {one['factor']:.4f}. Feature points in head coordinates, A: "
        f"{one['points_mm']:.2f} mm from those of two cameras (thesis: {THESIS_POINTS_MM}), "
        f"{one['shapes_mm']:.2f} mm after each point's constant offset; both after one constant rigid "
        "movement."
    )
    report.judge("A: feature points in head coordinates, mm", one["points_mm"], most=THESIS_POINTS_MM)
    known = {name: path for name in EXPERIMENTS if (path := results[name]) is not None}
    _draw(options, stereo, known, report)


def _draw(options: Options, stereo: Path, results: dict[str, Path], report: Report) -> None:
    """Add figures 4.10 to 4.14."""
    out, compared = options.output, {name: heads.compare(path, stereo) for name, path in results.items()}
    recording = out / f"recordings/{options.test(options.persons[0])}.mcap"
    shown = ("--recording", str(recording), "--select", "spread:5", "--crop", "head", "--overwrite")
    for result, ending in ((stereo, "-two-cameras"), (results["A"], "")):
        command("view", str(result), "-o", str(out / f"figure4.10{ending}.png"), *shown)
    moved, shapes = compared["A"].points_mm()
    lines = {"one rigid movement removed": moved, "each point's offset, too": shapes}
    curves = {name: (np.arange(len(errors)), errors.mean(axis=1)) for name, errors in lines.items()}
    plots.over_time(out / "figure4.11.png", [[plots.Panel("mean error of points, mm", curves)]], "frame")
    for number, names in (("4.12", "A"), ("4.13", "AB"), ("4.14", "AC")):
        draw_poses(out / f"figure{number}.png", {name: compared[name] for name in names})
    captions = {
        "4.10-two-cameras": "two cameras",
        "4.10": "one camera, experiment A",
        "4.11": "mean error of the feature points in head coordinates, experiment A",
        "4.12": "pose of experiment A; on the right the errors",
        "4.13": "pose of experiments A and B",
        "4.14": "pose of experiments A and C",
    }
    for number, text in captions.items():
        report.picture(out / f"figure{number}.png", f"Figure {number}: {text}")


def draw_poses(path: Path, compared: dict[str, heads.Compared]) -> None:
    """Plot the six pose components by experiment, next to their differences from the stereo result.

    All experiments have the same reference. Frames that were not followed are gaps.
    """

    def curve(one: heads.Compared, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.arange(len(values), dtype=np.float64), np.where(one.followed, values, np.nan)

    first, panels = next(iter(compared.values())), []
    for column, label in enumerate(heads.AXES):
        values = {"two cameras": curve(first, first.true_columns[:, column])}
        values |= {name: curve(one, one.columns[:, column]) for name, one in compared.items()}
        errors = {name: curve(one, one.pose[:, column]) for name, one in compared.items()}
        panels.append([plots.Panel(label, values), plots.Panel(f"|error|: {label}", errors)])
    plots.over_time(path, panels, "frame")


# All persons

PAIRS = (
    ("C", "A", "adjusted at the start → always, one pass"),
    ("C-2", "A-2", "adjusted at the start → always, two passes"),
    ("never", "C", "never adjusted → at the start, one pass"),
    ("never-2", "C-2", "never adjusted → at the start, two passes"),
    ("A", "A-2", "one pass → two passes"),
    ("B", "A", "person not in the model → in the model, one pass"),
    ("B", "shipped", "model of 10 other persons → shipped model, one pass"),
    ("A-paper", "A", "as printed → default, A, one pass"),
    ("C-paper", "A-paper", "as printed: adjusted at the start → always"),
)
METRICS = {
    "position_mm": "position, mm",
    "z_mm": "z, mm",
    "rotation_deg": "rotation, deg",
    "pitch_deg": "pitch, deg",
    "yaw_deg": "yaw, deg",
    "shapes_mm": "points in head, mm",
}


def _report_population(options: Options, files: Files, report: Report) -> None:
    report.text(
        "## Over all persons",
        f"{options.people} persons of {options.frames} frames each, against the truth. {EXPLAINED}",
    )
    for title, align in WAYS.items():
        rows = {
            name: {
                str(person): figures
                for person in options.persons
                if (figures := heads.mono_figures(files.made(_mono(options, person, name)), None, align))
            }
            for name in POPULATION
        }
        report.text(f"### {title.capitalize()}")
        titled = {POPULATION[name].title: list(found.values()) for name, found in rows.items()}
        report.entrants(f"population, {title}", COLUMNS, titled)
        if align == "rigid":
            chosen_pairs = {
                (what, name): pairs_of(rows[first], rows[second], metric)
                for first, second, what in PAIRS
                for metric, name in METRICS.items()
            }
            report.pairs("population, paired", ("", ""), chosen_pairs)


STUDY = Study(
    "mono",
    Options,
    (
        Part("people", _people_jobs, _report_people),
        Part("clips", _clips_jobs, _report_clips),
        Part("experiments", population_jobs, _report_experiments),
        Part("population", population_jobs, _report_population),
    ),
    lambda options: thesis_head(
        "Head pose and face deformation from one camera", 4, "head-mono", options.modelled
    ),
    __doc__,
    {"people": 1, "model_people": 6, "frames": 180, "motion_frames": LEAST_MOTION_FRAMES},
)
