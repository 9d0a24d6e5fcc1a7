"""Reproduce section 7 of Kajihara and Tanaka's paper, and answer its open question."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from benchmarking.stepping import hand_walker, in_turn
from posetrack_cli.build import version
from posetrack_cli.cli.options import recording_options
from posetrack_cli.configuration import find_configuration, load_settings
from posetrack_cli.evaluation.judging.comparing import SIGNIFICANCE
from posetrack_cli.evaluation.reading.tracks import associate
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model.anatomy import ANGLE_NAMES
from posetrack_cli.rendering.devices import open_fastest_device
from posetrack_cli.results import load_arrays
from posetrack_cli.synthesis.hand.frames import synthesise
from posetrack_cli.synthesis.hand.options import Switches, SynthOptions
from research import plots
from research.hands import figures_of
from research.report import Column, Figures, Report, pairs_of
from research.runner import FILE, Files, Job, Step
from research.study import FIRST_SEED, Part, Study, setting

# Motion and speed. A and B show a bare hand, as in the paper, C all that a Kinect sees.
CONDITIONS = tuple(itertools.product("ABC", (1.0, 2.0)))
TRUTH = "/truth/hand/estimate"


class Entrant(NamedTuple):
    """A way to track: a shipped configuration and what differs from it."""

    configuration: str
    changes: dict[str, Any]

    @property
    def arguments(self) -> tuple[str, ...]:
        """Of ``posetrack hand run``; no mesh is written, as nothing shows it."""
        changes = self.changes | {"output.mesh": "none"}
        settings = (part for key, value in changes.items() for part in ("--set", f"{key}={value}"))
        return ("--config", self.configuration, *settings)


# The paper's question is about sampling from the motion alone; such particles need a wide sigma
PLAIN = {"filter.proposal": "marginal", "observation.sigma_mm": 4.0}
ENTRANTS = {
    f"{kind}-{name}": Entrant(configuration, {"filter.kind": kind, **changes})
    for name, configuration, changes in (
        ("printed", "hand-paper", {}),
        ("paper", "hand", {"observation.cost": "paper"} | PLAIN),
        ("union", "hand", {"observation.cost": "union"} | PLAIN),
        ("default", "hand", {}),
    )
    for kind in ("pf", "rbpf")
}
STUDIED = ("printed", "paper", "union")  # those whose recordings are compared
# Rows of figures, and their entrants
ROWS = {"hand-paper": "printed", "union cost, drawn from the motion": "union", "hand (default)": "default"}


@dataclass(frozen=True)
class Options:
    """Settings of the study; ``reading``: arguments for opening the real recording."""

    output: Path
    seeds: int = setting("--seeds", 20, "Recordings per condition.")
    frames: int = setting("--frames", 150, "Frames per recording.", 2)
    kinect: Path | None = setting(  # noqa: RUF009
        "--kinect",
        None,
        "Real recording for figures 8 and 9.",
        type=click.Path(path_type=Path, resolve_path=True),
    )
    kinect_frames: str = setting("--kinect-frames", "0::20", "Frames of it to show.", show_default=True)
    reading: tuple[str, ...] = ()

    def result(self, motion: str, speed: float, seed: int, entrant: str) -> str:
        """Return the path of a result."""
        return f"runs/{motion}-{speed:g}x-{seed}-{self.frames}-{entrant}.mcap"


def tracked(options: Options, motion: str, speed: float, seed: int, entrants: Iterator[str]) -> Job:
    """Return the job of a recording; all entrants use the seed of the recording, so they form pairs.

    C starts at the image centre, A and B start from the true pose.
    """
    name = f"{motion}-{speed:g}x-{seed}-{options.frames}"
    made = ("hand", "synth", "--motion", motion, "--speed", f"{speed:g}", "--seed", str(seed))
    recording = Step(f"recordings/{name}.mcap", (*made, "--frames", str(options.frames)), scratch=True)
    start = "center" if motion == "C" else FILE + recording.output
    known = ("--hand-side", "right", "--shape", "average", "--seed", str(seed), "--init", start)
    steps = (
        Step(
            options.result(motion, speed, seed, entrant),
            ("hand", "run", FILE + recording.output, *ENTRANTS[entrant].arguments, *known),
        )
        for entrant in entrants
    )
    return Job(name, (recording, *steps))


# Figures 6 to 9

# The paper's statements, in our words
PAPER = {
    "A": "For small changes without velocity both methods give nearly right estimates for some parts of the "
    "hand (left); other parts neither follows well (right). The methods do not differ visibly (7.2.1, "
    "figure 6).",
    "B": "Hardly different from A: some components are followed, others are not, and the methods do not "
    "differ visibly (7.2.2, figure 7).",
    "real": "Both methods follow slow motion of the hand and of the fingers, but not accurately; they do not "
    "differ much. The cost does not compare the image regions, which may be why (7.3, figures 8 and 9).",
    "time": "The time per frame of the two methods hardly differs although the state has twice as many "
    "dimensions; a frame takes longer than the sensor's interval (7.4, figure 10).",
    "conclusion": "No evidence that velocity makes tracking more accurate, at almost no additional cost; "
    "the cost function may be the reason (8).",
}


class Component(NamedTuple):
    """One component of the pose, as an axis shows it: ``factor`` times a column of an array."""

    label: str
    field: str
    column: int
    factor: float = 1.0

    def of(self, arrays: Mapping[str, Any]) -> Any:
        """Return its values (N,)."""
        return self.factor * arrays[self.field][:, self.column]

    def rms(self, track: Mapping[str, Any], truth: Mapping[str, Any]) -> float:
        """Return the RMS error of a track."""
        pairs = associate(track["stamp_ns"], truth["stamp_ns"], tolerance_ns=0)
        errors = self.of(track)[pairs.estimate] - self.of(truth)[pairs.truth]
        return float(np.sqrt(np.mean(errors**2)))


WRIST_X, WRIST_Y = Component("wrist x, mm", "position", 0), Component("wrist y, mm", "position", 1)
MIDDLE = Component("middle, joint 2, deg", "shape", ANGLE_NAMES.index("middle_pip_flexion"), 180.0 / np.pi)
# By motion the figure's number and its columns
SHOWN = {"A": ("6", (WRIST_Y, MIDDLE)), "B": ("7", (WRIST_Y, WRIST_X))}


def _artificial_jobs(options: Options) -> Iterator[Job]:
    for motion in SHOWN:
        entrants = (f"{kind}-{name}" for name in ROWS.values() for kind in ("pf", "rbpf"))
        yield tracked(options, motion, 1.0, FIRST_SEED, entrants)


def _report_artificial(options: Options, files: Files, report: Report) -> None:
    for motion, (number, components) in SHOWN.items():
        report.text(f"## Artificial data {motion} (figure {number})", f"> **Paper:** {PAPER[motion]}")
        panels, errors = [], {}
        for title, name in ROWS.items():
            results = (
                (kind.upper(), files.made(options.result(motion, 1.0, FIRST_SEED, f"{kind}-{name}")))
                for kind in ("pf", "rbpf")
            )
            paths = {kind: path for kind, path in results if path is not None}
            if len(paths) < 2:
                continue
            truth = load_arrays(paths["PF"], TRUTH)
            tracks = {"truth": truth} | {kind: load_arrays(path) for kind, path in paths.items()}
            times = {kind: 1e-9 * (a["stamp_ns"] - truth["stamp_ns"][0]) for kind, a in tracks.items()}
            rows = [{kind: (times[kind], one.of(a)) for kind, a in tracks.items()} for one in components]
            panels.append(
                [plots.Panel(one.label, row, title) for one, row in zip(components, rows, strict=True)]
            )
            for kind in paths:
                errors[f"{title}, {kind}"] = {one.label: one.rms(tracks[kind], truth) for one in components}
        if panels:
            picture = options.output / f"figure{number}.png"
            plots.over_time(picture, panels, "time, s")
            report.picture(picture, "Truth, PF and RBPF")
            columns = [Column(one.label, f"RMS error: {one.label}", 1) for one in components]
            report.figures(f"figure {number}", columns, errors, {})


def _real_jobs(options: Options) -> Iterator[Job]:
    if options.kinect is None:
        return
    for kind, name in itertools.product(("pf", "rbpf"), ROWS.values()):
        entrant, number = f"{kind}-{name}", {"pf": 8, "rbpf": 9}[kind]
        run = ("hand", "run", str(options.kinect), *ENTRANTS[entrant].arguments, *options.reading)
        result = Step(f"runs/kinect-{entrant}.mcap", run)
        sheet = ("--layout", "paper", "--select", options.kinect_frames, "--recording", str(options.kinect))
        view = ("view", FILE + result.output, *sheet, *options.reading)
        yield Job(f"kinect-{entrant}", (result, Step(f"figure{number}-{name}.png", view)))


def _report_real(options: Options, files: Files, report: Report) -> None:
    report.text("## Real depth (figures 8 and 9)", f"> **Paper:** {PAPER['real']}")
    if options.kinect is None:
        report.text("Not redone: no real recording was given (`--kinect`).")
    for number, (title, name) in itertools.product((8, 9), ROWS.items()):
        picture = files.made(f"figure{number}-{name}.png")
        if picture is not None:
            report.text(f"Figure {number}, {title}: observed above, estimate below.")
            report.picture(picture, "Observed and estimated depth")


# Figure 10

PARTICLES = (64, 128, 256, 512, 1024, 2048, 4096)
TIMED_FRAMES, WARM_UP = 34, 4


def _report_times(options: Options, files: Files, report: Report) -> None:
    """Time both filters alternately, frame by frame, on motion B with the paper's settings."""
    device = open_fastest_device()
    made = SynthOptions("B", TIMED_FRAMES, FIRST_SEED, 1.0, switches=Switches.usual("B"))
    recorded = [(frame.depth.astype(np.float32),) for frame in synthesise(made, device=device)]
    taken: dict[str, list[float]] = {"PF": [], "RBPF": []}
    for particles in PARTICLES:
        walkers = {}
        for name in taken:
            changes = {"filter.kind": name.lower(), "filter.particles": particles}
            config = load_settings(HandConfig, find_configuration("hand-paper"), changes)
            walkers[name] = hand_walker(device, config, recorded[0][0])
        for name, seconds in in_turn(walkers, recorded, WARM_UP).items():
            taken[name].append(1e3 * float(np.median(seconds)))
    plots.times(options.output / "figure10.png", PARTICLES, taken)
    report.text("## Time per frame (figure 10)", f"> **Paper:** {PAPER['time']}")
    report.picture(options.output / "figure10.png", "Time per frame against particles")
    rows = {
        str(n): {"pf": pf, "rbpf": rbpf, "ratio": rbpf / pf}
        for n, pf, rbpf in zip(PARTICLES, *taken.values(), strict=True)
    }
    columns = (Column("pf", "PF, ms", 1), Column("rbpf", "RBPF, ms", 1), Column("ratio", "RBPF / PF"))
    report.figures("time", columns, rows, {})
    report.text(
        f"Rows are particles, medians over {TIMED_FRAMES - WARM_UP} frames of motion B; {device.info}."
    )


# The question left open

METRICS = {"joint_error_mm": ("error_mm", "mean error of the 21 joints", "mm", 5.0)}
METRICS["velocity_error_mm_s"] = ("velocity_error_mm_s", "mean error of the wrist's velocity", "mm/s", 50.0)
QUESTIONS = {
    "PF against RBPF": [(f"pf-{name}", f"rbpf-{name}") for name in STUDIED],
    "The paper's cost against the union cost": [
        (f"{kind}-paper", f"{kind}-union") for kind in ("pf", "rbpf")
    ],
}
RELIABILITY = (
    Column("coverage", "coverage", 3),
    Column("nees", "NEES, median (21 is consistent)", 0, whole="median"),
    Column("inside_90", "truth inside 90 % intervals"),
)


def _study_jobs(options: Options) -> Iterator[Job]:
    for (motion, speed), k in itertools.product(CONDITIONS, range(options.seeds)):
        entrants = (f"{kind}-{name}" for name in STUDIED for kind in ("pf", "rbpf"))
        yield tracked(options, motion, speed, FIRST_SEED + k, entrants)


def _report_study(options: Options, files: Files, report: Report) -> None:
    found: dict[str, dict[tuple[str, float], dict[str, Figures]]] = {}
    for kind, name in itertools.product(("pf", "rbpf"), STUDIED):
        entrant = f"{kind}-{name}"
        for condition in CONDITIONS:
            seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
            of = {str(k): figures_of(files.made(options.result(*condition, k, entrant))) for k in seeds}
            found.setdefault(entrant, {})[condition] = {k: one for k, one in of.items() if one}
    report.text(
        "## Does velocity help? The question left open",
        f"> **Paper:** {PAPER['conclusion']}",
        "A pair is one recording, tracked twice with the same seed. `paper` and `union` name the cost; "
        "particles are drawn from the motion, not by local fits; all else is as in `hand.toml`. `printed` "
        "is `hand-paper`. Errors are means over all frames of a recording, lost ones included; negative "
        "differences favour the second. p adjusted: Benjamini and Hochberg over the table's rows. Motion A "
        "has no velocity.",
    )
    every = {name: [one for of in rows.values() for one in of.values()] for name, rows in found.items()}
    report.entrants("reliability", RELIABILITY, every)
    for metric, (figure, title, unit, linear_to) in METRICS.items():
        for question, pairs in QUESTIONS.items():
            report.text(f"### {question}: {title}, {unit}")
            rows = {
                (motion, f"{speed:g}", first, second): pairs_of(
                    found[first][motion, speed], found[second][motion, speed], figure
                )
                for first, second in pairs
                for motion, speed in CONDITIONS
            }
            rows = {row: values for row, values in rows.items() if len(values)}
            if rows:
                said = report.pairs(f"{question}: {metric}", ("motion", "speed", "first", "second"), rows)
                name = f"study-{metric}-{'filter' if question.startswith('PF') else 'cost'}.png"
                labels = {
                    f"{motion}, speed {speed}: {second} - {first}": (np.diff(values, axis=1)[:, 0], one)
                    for ((motion, speed, first, second), values), one in zip(rows.items(), said, strict=True)
                }
                plots.differences(options.output / name, f"{question}: {title}", unit, linear_to, labels)
                report.picture(options.output / name, "Differences per recording")


def _head(options: Options) -> Iterator[str]:
    yield "# The hand paper's experiments, redone"
    yield (
        "Kajihara and Tanaka, *3D hand pose tracking with a Rao-Blackwellized particle filter*, section 7, "
        f"by posetrack {version()}. PF is the plain particle filter, RBPF the Rao-Blackwellized one. 30 "
        f"Hz. Study: {options.seeds} recordings of {options.frames} frames per condition; differences are "
        f"significant below {SIGNIFICANCE:g}."
    )
    plain = ", ".join(f"`{key}={value}`" for key, value in ENTRANTS["rbpf-union"].changes.items())
    yield (
        "*hand-paper* is `--config hand-paper`: the paper as printed, as far as there are keys "
        "(`docs/method.md`); noise densities, which it does not print, are ours. *Union cost, drawn from "
        f"the motion* is `hand.toml` with {plain}. *hand (default)* is `hand.toml` itself, with the "
        "recording's hand."
    )


def _options(
    output: Path, seeds: int, frames: int, kinect: Path | None, kinect_frames: str, **reading: Any
) -> Options:
    """Return the options; those for the recording are passed on unchanged."""
    given = []
    for name, value in reading.items():
        if value not in (None, False):
            flag = "--" + name.removesuffix("_file").replace("_", "-")
            given += [flag] if value is True else [flag, str(value)]
    return Options(output, seeds, frames, kinect, kinect_frames, tuple(given))


STUDY = Study(
    "hand",
    Options,
    (
        Part("artificial", _artificial_jobs, _report_artificial),
        Part("real", _real_jobs, _report_real),
        Part("time", lambda options: (), _report_times),
        Part("study", _study_jobs, _report_study),
    ),
    _head,
    __doc__,
    more=(recording_options,),
    made=_options,
)
