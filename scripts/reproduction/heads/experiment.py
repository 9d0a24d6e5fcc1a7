"""The thesis's experiment 3.4: rigid against deformable model over one long recording."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.cli.main import run as posetrack
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE
from posetrack_cli.evaluation.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.metrics.head_metrics import HEAD_POSE
from posetrack_cli.results import load_arrays, read_result
from reproduction.accuracy.measuring import number
from reproduction.heads import figures
from reproduction.heads.measuring import FOLLOWED, MOVING_MM, RIGID_FRAMES, Course, Measured, course_of
from reproduction.heads.options import Options, synthetic
from reproduction.heads.tables import COLUMNS, EXPLAINED, accuracy_rows
from reproduction.heads.tasks import Task
from reproduction.running import Targets, table

DEFORMING_PART = 2 / 3
"""Of the recording, as in the thesis: 1200 of 1800 frames."""
SETTLED_FRAMES = 600
"""After so many frames the contribution ratio is said to have come back."""
PICTURES = 3
SAID = {
    "deforming": "From frame 121 to about frame 1200, while the face deforms, the two estimates clearly "
    "differ; the pictures show that those of the deformable model are the right ones (3.4, figures 3.9 and "
    "3.10).",
    "rigid": "Over the remaining 600 frames or so the two nearly coincide: the deformable model follows "
    "rigid motion without needless deformation (3.4, figure 3.10).",
    "contribution": "The cumulative contribution ratio of the five components drops sharply once, right "
    "after tracking begins, and is back near 80 % after some 600 frames, 20 s, of learning (3.4, figure "
    "3.10).",
    "speed": "30 frames per second with 1000 particles on a Pentium 4, 3.0 GHz (3.4).",
}
"""The thesis's statements, in our words."""
MODELS = {"head-stereo": ("rigid", "deformable"), "head-stereo-paper": ("paper-rigid", "paper")}


@dataclass(frozen=True, eq=False)
class Spans:
    """Rows of the two parts that the thesis compares."""

    deforming: BoolArray
    rigid: BoolArray

    @classmethod
    def of(cls, frames: int) -> Spans:
        """The parts of a recording of so many frames."""
        rows = np.arange(frames)
        end = first_rigid(frames)
        return cls((rows >= RIGID_FRAMES) & (rows < end), rows >= end)


class Experiment:
    """Figures 3.9 and 3.10, and the figures that belong to what the thesis says about them."""

    name = "experiment"

    def tasks(self, options: Options) -> list[Task]:
        """One recording."""
        return [task_of(options)]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """Both pairs of models, each with its figure."""
        frames = options.experiment_frames
        yield "## Experiment 3.4: rigid and deformable model"
        yield ""
        yield (
            f"{frames} frames of a synthetic head: the face deforms until frame {first_rigid(frames)}, then "
            f"only the head moves. The first {RIGID_FRAMES} frames are tracked with a rigid model in any "
            "case."
        )
        yield ""
        task = task_of(options)
        for title, pair in MODELS.items():
            if not all(task.result(options.output, name).exists() for name in pair):
                yield f"`{title}` was not tracked."
                yield ""
                continue
            yield from _of_configuration(options, task, title, pair)
        yield "### Over the whole recording"
        yield ""
        yield EXPLAINED
        yield ""
        yield from table(("", *COLUMNS), accuracy_rows([task], measured))
        yield from _speed(task, measured)


def task_of(options: Options) -> Task:
    """The experiment's recording."""
    person, frames = options.first_identity, options.experiment_frames
    entrants = tuple(name for pair in MODELS.values() for name in pair)
    return Task(f"experiment-{person}-{frames}", synthetic(person, frames), entrants=entrants)


def first_rigid(frames: int) -> int:
    """The first frame of the part in which the face does not deform."""
    return round(DEFORMING_PART * frames)


def _of_configuration(options: Options, task: Task, title: str, pair: tuple[str, str]) -> Iterator[str]:
    """Figures, and the thesis's statements with our figures."""
    out = options.output
    paths = {
        name: task.result(out, entrant) for name, entrant in zip(("rigid", "deformable"), pair, strict=True)
    }
    evaluated = {name: evaluate(path, EvalOptions(align="rigid+points")) for name, path in paths.items()}
    courses = {name: course_of(evaluation) for name, evaluation in evaluated.items()}
    truth = evaluated["deformable"].truth
    assert truth is not None  # synthetic recordings have one, and their results carry it
    contribution = contribution_ratio(paths["deformable"])
    spans = Spans.of(len(contribution))
    ending = "" if title == "head-stereo" else "-paper"
    pictures, graph = out / f"figure3.9{ending}.png", out / f"figure3.10{ending}.png"
    _draw_pictures(pictures, task.recording(out), paths, picture_frames(courses["deformable"], spans))
    tracks = {"truth": truth} | {name: evaluation.track for name, evaluation in evaluated.items()}
    parts = (RIGID_FRAMES, first_rigid(len(contribution)))
    figures.poses_over_time(graph, tracks, courses, contribution, parts)
    yield f"### `{title}`"
    yield ""
    yield "Figure 3.9: both cameras, rigid model above, deformable model below."
    yield ""
    yield f"![Poses and points of both models on the images]({pictures.name})"
    yield ""
    yield "Figure 3.10: rigid model thin, deformable model thick, and on the right the errors of both."
    yield ""
    yield f"![Pose over time and contribution ratio]({graph.name})"
    yield ""
    poses = {name: figures.pose_columns(evaluation.track) for name, evaluation in evaluated.items()}
    for part, rows in (("deforming", spans.deforming), ("rigid", spans.rigid)):
        yield f"> **Thesis:** {SAID[part]}"
        yield ""
        yield from _part_table(poses, courses, rows)
    yield f"> **Thesis:** {SAID['contribution']}"
    yield ""
    yield from _contribution_lines(contribution)


def _draw_pictures(path: Path, recording: Path, results: Mapping[str, Path], frames: list[int]) -> None:
    """Figure 3.9, by ``posetrack view``."""
    chosen = ",".join(map(str, frames))
    both = [str(results[name]) for name in ("rigid", "deformable")]
    arguments = ["--recording", str(recording), "--select", chosen, "--crop", "head", "--overwrite"]
    code = posetrack(["view", *both, "-o", str(path), *arguments])
    if code not in (EXIT_DONE, EXIT_DATA_LOST):
        sys.exit(code)


def picture_frames(one: Course, spans: Spans) -> list[int]:
    """The greatest deformation of each third of the deforming part, and the middle of the rigid part."""
    moved = one.moved_mm[:, FOLLOWED].max(axis=1)
    thirds = [rows for rows in np.array_split(np.flatnonzero(spans.deforming), PICTURES) if rows.size]
    chosen = [int(rows[np.argmax(moved[rows])]) for rows in thirds]
    return [*chosen, int(np.median(np.flatnonzero(spans.rigid)))]


def contribution_ratio(result: Path) -> FloatArray:
    """Return the cumulative contribution ratio (N,) that a result states, NaN before anything is learned."""
    column = read_result(result).subject.number_names.index("contribution_ratio")
    ratio: FloatArray = load_arrays(result)["numbers"][:, column]
    return ratio


def _part_table(
    poses: Mapping[str, FloatArray], courses: Mapping[str, Course], rows: BoolArray
) -> Iterator[str]:
    """How far the two models are from each other and from the truth."""
    apart = np.abs(poses["deformable"] - poses["rigid"])[rows]
    lines = [("rigid and deformable, apart by", *(number(v) for v in apart.mean(axis=0)), "-")]
    for name, one in courses.items():
        cells = [number(float(v)) for v in one.pose[rows].mean(axis=0)]
        lines.append((f"error of the {name} model", *cells, _moving_error(one, rows)))
    yield from table(("mean, mm or deg", *(_short(name) for name in HEAD_POSE), "moving points, mm"), lines)


def _moving_error(one: Course, rows: BoolArray) -> str:
    moving = one.moved_mm[rows][:, FOLLOWED] > MOVING_MM
    values = one.points_mm[rows][:, FOLLOWED][moving]
    return number(float(values.mean())) if values.size else "-"


def _short(name: str) -> str:
    return name.rsplit("_", 1)[0]


def _contribution_lines(contribution: FloatArray) -> Iterator[str]:
    known = np.flatnonzero(np.isfinite(contribution))
    if not known.size:
        yield "Ours: nothing was learned."
        yield ""
        return
    lowest = known[np.argmin(contribution[known])]
    after = min(int(known[0]) + SETTLED_FRAMES, len(contribution) - 1)
    yield (
        f"Ours: learning begins in frame {known[0]}; lowest {contribution[lowest]:.0%} in frame {lowest}; "
        f"{contribution[after]:.0%} in frame {after}; {contribution[-1]:.0%} in the end."
    )
    yield ""


def _speed(task: Task, measured: Measured) -> Iterator[str]:
    yield f"> **Thesis:** {SAID['speed']}"
    yield ""
    found = {entrant: measured.figures(task, entrant).get("ms") for entrant in task.entrants}
    told = ", ".join(f"{name} {ms:.1f}" for name, ms in found.items() if ms is not None)
    yield f"Ours, median milliseconds of tracking per frame, one core, beside the study's other runs: {told}."
    yield ""
