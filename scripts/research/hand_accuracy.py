"""Accuracy of the hand tracker on its own model, with seeds that were never used for tuning."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posetrack_cli.build import version
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions
from posetrack_cli.hand.smoothing import SMOOTH_POSE, SMOOTH_VELOCITY
from posetrack_cli.results.topics import FILTERED, SMOOTHED
from research.hands import VELOCITIES, evaluated, figures_of, velocities_of
from research.report import Column, Figures, Report, pairs_of
from research.runner import FILE, Files, Job, Step
from research.study import FIRST_SEED, FOLDER, Part, Study, setting, unused_for_tuning

NO_MESH = ("--set", "output.mesh=none")
# The rendered hand is the average one, so the shape need not be estimated
AVERAGE = ("--shape", "average")


@dataclass(frozen=True)
class Options:
    """Settings of the study."""

    output: Path
    seeds: int = setting("--seeds", 20, "Recordings per condition.")
    frames: int = setting("--frames", 300, "Frames per recording.", 2)
    first_seed: int = setting(
        "--first-seed", FIRST_SEED, "Of the recordings; smaller ones are for trials.", 0
    )
    kinect: Path | None = setting(  # noqa: RUF009
        "--kinect", None, "Folder of the real Kinect v2 recording.", type=FOLDER
    )
    entrants: tuple[str, ...] = setting(
        "--entrant", (), "Run this way to track alone, such as hand; repeatable.", multiple=True
    )

    @property
    def all_seeds(self) -> range:
        """Seeds of the recordings."""
        return range(self.first_seed, self.first_seed + self.seeds)


def recorded(
    options: Options, name: str, made: tuple[str, ...], entrants: Mapping[str, tuple[str, ...]]
) -> Job:
    """Return the job of a recording that all chosen entrants track; the recording is deleted afterwards."""
    recording = Step(f"recordings/{name}.mcap", made, scratch=True)
    tracked = (
        Step(f"runs/{name}-{entrant}.mcap", ("hand", "run", FILE + recording.output, *arguments))
        for entrant, arguments in entrants.items()
        if not options.entrants or entrant in options.entrants
    )
    return Job(name, (recording, *tracked))


def synthetic(options: Options, motion: str, speed: float, seed: int, *more: str) -> tuple[str, ...]:
    """Return the arguments for a synthetic recording with the default effects of its motion."""
    made = ("hand", "synth", "--motion", motion, "--speed", f"{speed:g}", "--seed", str(seed))
    return (*made, "--frames", str(options.frames), *more)


def measured(
    options: Options, files: Files, begin: str, end: str, track: str = FILTERED
) -> dict[str, Figures]:
    """Return the figures of the existing results by seed."""
    names = {str(seed): f"runs/{begin}-{seed}-{options.frames}{end}.mcap" for seed in options.all_seeds}
    made = {seed: files.made(name) for seed, name in names.items()}
    found = {seed: figures_of(path, track) | velocities_of(path, track) for seed, path in made.items()}
    return {seed: figures for seed, figures in found.items() if figures}


# Own model: every configuration, smoothing, the swarm

SPEEDS = (1.0, 2.0)
OWN = {
    "hand": ("--config", "hand", "--smooth", *AVERAGE, *NO_MESH),
    "hand-fast": ("--config", "hand-fast", *AVERAGE, *NO_MESH),
    "hand-pso": ("--config", "hand-pso", *AVERAGE, *NO_MESH),
    "hand-paper": ("--config", "hand-paper", *AVERAGE, *NO_MESH),
}
OWN_ROWS = {
    "`hand` (default)": ("hand", FILTERED),
    "`hand --smooth`, smoothed": ("hand", SMOOTHED),
    **{f"`{name}`": (name, FILTERED) for name in ("hand-fast", "hand-pso", "hand-paper")},
}
OWN_PAIRS = {
    "filtered → smoothed": ("`hand` (default)", "`hand --smooth`, smoothed"),
    "PSO (64 x 25) → `hand`": ("`hand-pso`", "`hand` (default)"),
}
OWN_COLUMNS = (
    Column("error_mm", "mean error, mm", spread=True),
    Column("worst_mm", "worst", whole="max"),
    Column("p95_mm", "p95, mm"),
    Column("lost_share", "lost", percent=True),
    Column("astray", "astray", percent=True),
    Column("inside_90", "inside 90 %"),
    Column("evaluations", "poses a frame", digits=0),
    *(Column(name, title) for name, title in VELOCITIES.items()),
)


def _own_jobs(options: Options) -> Iterator[Job]:
    for speed in SPEEDS:
        for seed in options.all_seeds:
            name = f"C-{speed:g}x-{seed}-{options.frames}"
            yield recorded(options, name, synthetic(options, "C", speed, seed), OWN)


def _report_own(options: Options, files: Files, report: Report) -> None:
    report.text(
        "## Own model, all Kinect effects, automatic start",
        "Motion C with noise, edges, background, body, forearm, dropped and late frames. Errors are of the "
        "21 joints over all frames, lost ones included; worst: largest mean of a recording; p95: mean over "
        "recordings of each one's 95th percentile. Astray: frames whose mean joint error is 20 mm or more, "
        "whatever their status. Inside 90 %: share of the 21 pose entries within their stated interval.",
    )
    for speed in SPEEDS:
        rows = {
            title: measured(options, files, f"C-{speed:g}x", f"-{entrant}", track)
            for title, (entrant, track) in OWN_ROWS.items()
        }
        report.text(f"### Speed {speed:g}")
        found = {
            title: [dict(one, worst_mm=one["error_mm"]) for one in of.values()] for title, of in rows.items()
        }
        report.entrants(f"own, speed {speed:g}", OWN_COLUMNS, found)
        pairs = {(what,): pairs_of(rows[a], rows[b], "error_mm") for what, (a, b) in OWN_PAIRS.items()}
        report.pairs(f"own, speed {speed:g}, paired", ("error, mm",), pairs)


# RBPF against the plain filter


CONDITIONS = (*((motion, speed, 30) for motion in "BC" for speed in (1.0, 2.0)), ("C", 3.0, 30))
CONDITIONS += tuple(("C", 1.0, fps) for fps in (10, 20, 60))
"""Motion, speed and frame rate."""
PROPOSALS = {"guided": "local fits", "paper": "(51) as printed"}
# The noise densities of the smoothed track, with which nearly all motion is velocity
SMOOTH = tuple(
    part
    for name, settings in (("pose", SMOOTH_POSE), ("velocity", SMOOTH_VELOCITY))
    for key, value in settings
    for part in ("--set", f"motion.{name}.{key}={value}")
)
FILTERS = {"pf": ("pf", ()), "rbpf": ("rbpf", ()), "smooth": ("rbpf", SMOOTH)}


def _filters_name(condition: tuple[str, float, int], seed: object = "") -> str:
    motion, speed, fps = condition
    return f"{motion}-{speed:g}x-{fps}Hz" + (f"-{seed}" if seed else "")


def _filters_jobs(options: Options) -> Iterator[Job]:
    for condition in CONDITIONS:
        motion, speed, fps = condition
        for seed in options.all_seeds:
            name = f"{_filters_name(condition, seed)}-{options.frames}-filters"
            # both filters start from the true pose, so that initialisation does not matter
            common = ("--init", f"{FILE}recordings/{name}.mcap", *AVERAGE, *NO_MESH)
            entrants = {
                f"{filter_}-{proposal}": (
                    *("--config", "hand", "--filter", kind, "--set", f"filter.proposal={proposal}"),
                    *densities,
                    *common,
                )
                for filter_, (kind, densities) in FILTERS.items()
                for proposal in PROPOSALS
            }
            yield recorded(
                options, name, synthetic(options, motion, speed, seed, "--fps", str(fps)), entrants
            )


def _report_filters(options: Options, files: Files, report: Report) -> None:
    report.text(
        "## RBPF against the plain filter, same budget",
        "All filters on the same recordings with the same seed, from the true pose, all else as in `hand`. "
        "B is a random walk of pose and velocity with a bare hand, C natural motion with all effects. "
        "Smooth: the RBPF with the noise densities of the smoothed track. Mean joint errors, mm; first is "
        "the plain filter.",
    )
    pairs = {}
    for proposal, drawn in PROPOSALS.items():
        for condition in CONDITIONS:
            found = {
                kind: measured(options, files, _filters_name(condition), f"-filters-{kind}-{proposal}")
                for kind in FILTERS
            }
            for kind, densities in (("rbpf", "default"), ("smooth", "smooth")):
                row = (_filters_name(condition), drawn, densities)
                pairs[row] = pairs_of(found["pf"], found[kind], "error_mm")
    report.pairs("filters", ("motion, speed, frame rate", "proposal", "densities"), pairs)


# A real hand

KINECT_CAMERA = "fx = 363.9\nfy = 363.9\ncx = 255.4\ncy = 206.3\n"


KINECT_COLUMNS = (
    Column("frames", "frames", 0),
    Column("lost", "lost", 0),
    Column("first", "first tracked frame", 0),
    Column("median", "region overlap, median", 3),
    Column("low", "5th percentile", 3),
)


def _kinect_jobs(options: Options) -> Iterator[Job]:
    if options.kinect is None:
        return
    camera = options.output / "kinect2.camera.toml"
    camera.write_text(KINECT_CAMERA, encoding="utf-8")
    made = Step("kinect2.mcap", ("convert", str(options.kinect), "--camera", str(camera), "--fps", "30"))
    run = ("hand", "run", FILE + made.output, "--hand-side", "left", "--config", "hand")
    yield Job("kinect", (made, Step("runs/kinect2-hand.mcap", run)))


def _report_kinect(options: Options, files: Files, report: Report) -> None:
    report.text("## Real Kinect v2, a left hand")
    result, recording = (files.made(name) for name in ("runs/kinect2-hand.mcap", "kinect2.mcap"))
    if result is None or recording is None:
        report.text("Not measured: no such recording was given (`--kinect`), or it failed.")
        return
    found = evaluated(result, EvalOptions(recording=recording))
    overlap, lost = found.series["region_overlap"], found.track.lost
    assert lost is not None
    median, low = (float(np.nanpercentile(overlap, percent)) for percent in (50.0, 5.0))
    row = {"lost": float(lost.sum()), "frames": float(len(lost)), "first": float(np.argmin(lost)) + 1.0}
    report.figures("kinect", KINECT_COLUMNS, {"recording": row | {"median": median, "low": low}})
    report.judge("Kinect: region overlap, median", median, least=0.85, digits=3)
    report.judge("Kinect: region overlap in 95 % of frames", low, least=0.72, digits=3)


def _head(options: Options) -> Iterator[str]:
    last = options.first_seed + options.seeds - 1
    yield "# Accuracy of the hand tracker"
    yield (
        f"posetrack {version()}; seeds {options.first_seed} to "
        f"{last}{unused_for_tuning(options.first_seed)}, {options.frames} frames each; {os.cpu_count()} "
        "cores."
    )


STUDY = Study(
    "hand-accuracy",
    Options,
    (
        Part("own", _own_jobs, _report_own),
        Part("filters", _filters_jobs, _report_filters),
        Part("kinect", _kinect_jobs, _report_kinect),
    ),
    _head,
    __doc__,
    {"seeds": 2, "frames": 20},
)
