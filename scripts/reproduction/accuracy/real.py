"""Real recordings: a Kinect v2's without truth, and head-mounted ones with annotated joints."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import BoolArray
from posetrack_cli.evaluation.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.evaluation import Curve, Evaluation
from posetrack_cli.evaluation.figures import figure_of
from reproduction import cvar
from reproduction.accuracy import pictures
from reproduction.accuracy.measuring import Measured, number
from reproduction.accuracy.options import Options
from reproduction.accuracy.tasks import Task
from reproduction.made import command
from reproduction.running import Targets, table

KINECT_CAMERA = "fx = 363.9\nfy = 363.9\ncx = 255.4\ncy = 206.3\n"
KINECT_HZ = 30.0
KINECT_NAME = "kinect2-hand"
ENTRANT = "hand"
LEFT = ("--hand-side", "left")
SHEET_FRAMES = 24
CVAR_SEQUENCES = ("P1", "P4")
OFFSET_AXES = ("bone", "palm", "camera")


class Kinect:
    """Start, overlap with the segmented hand, loss and recovery."""

    name = "kinect"

    def tasks(self, options: Options) -> list[Task]:
        """The one recording, as it is stored: a left hand."""
        if options.kinect is None:
            return []
        camera = options.output / "kinect2.camera.toml"
        camera.write_text(KINECT_CAMERA, encoding="utf-8")
        converted = ("convert", str(options.kinect), "--camera", str(camera), "--fps", f"{KINECT_HZ:g}", "-o")
        return [Task(KINECT_NAME, converted, {ENTRANT: (*LEFT, "--config", "hand")})]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A table, the overlap over time, and a sheet of frames to look at."""
        yield "## Real Kinect v2"
        yield ""
        for task in self.tasks(options):
            path = task.result(measured.folder, ENTRANT)
            if path.exists():
                recording = options.output / f"{KINECT_NAME}.mcap"
                command(*task.recording, str(recording), "--overwrite")
                yield from _kinect_lines(evaluate(path, EvalOptions(recording=recording)), options, targets)
                sheet = options.output / f"{KINECT_NAME}.png"
                chosen = ("--select", f"spread:{SHEET_FRAMES}", "--recording", str(recording), "--overwrite")
                command("view", str(path), "-o", str(sheet), *chosen)
                yield f"![Frames of the recording, observed and estimated]({sheet.name})"
                yield ""
                return
        yield "Not measured: no such recording was given (`--kinect`), or it failed."
        yield ""


def _kinect_lines(found: Evaluation, options: Options, targets: Targets) -> Iterator[str]:
    lost = np.zeros(len(found.track), dtype=np.bool_) if found.track.lost is None else found.track.lost
    overlap = found.series["region_overlap"]
    median, low = (float(np.nanpercentile(overlap, percent)) for percent in (50.0, 5.0))
    first = int(np.argmin(lost)) if not lost.all() else len(lost)
    rows = [
        ("first frame that is tracked, from 1", str(first + 1)),
        ("region overlap, median", number(median)),
        ("region overlap, 5th percentile", number(low)),
        ("lost frames", f"{int(lost.sum())} of {len(lost)}"),
        ("times that the track was lost", str(losses(lost))),
        ("ends lost", "yes" if lost[-1] else "no"),
    ]
    yield from table(("", "as it comes"), rows)
    targets.add("Kinect: starts within 5 frames", "<= 5", str(first + 1), first + 1 <= 5)
    targets.add("Kinect: region overlap, median", ">= 0.8", f"{median:.3f}", median >= 0.8)
    targets.add("Kinect: region overlap in 95 % of frames", ">= 0.6", f"{low:.3f}", low >= 0.6)
    targets.add(
        "Kinect: no unrecovered loss", "none", "lost at the end" if lost[-1] else "none", not lost[-1]
    )
    picture = options.output / f"{KINECT_NAME}-overlap.png"
    pictures.overlap(picture, 1e-9 * (found.series_stamp_ns - found.series_stamp_ns[0]), overlap)
    yield f"![Region overlap over time]({picture.name})"
    yield ""


def losses(lost: BoolArray) -> int:
    """How often a track goes from tracked to lost; the start counts if it is lost."""
    before = np.concatenate([[False], lost[:-1]])
    return int((lost & ~before).sum())


class HeadMounted:
    """Oberweger et al. 2016: error after one constant offset per joint, and the field's curve."""

    name = "cvar"

    def tasks(self, options: Options) -> list[Task]:
        """Both sequences, with the shape that a run finds."""
        if options.cvar is None:
            return []
        entrants = {ENTRANT: ("--config", "hand")}
        return [
            Task(name, cvar.conversion(options.cvar / name, options.output), entrants)
            for name in CVAR_SEQUENCES
        ]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A table with and without offsets, and the curve."""
        yield "## Head-mounted, very fast (Oberweger et al., CVPR 2016)"
        yield ""
        paths = {task.name: task.result(measured.folder, ENTRANT) for task in self.tasks(options)}
        paths = {name: path for name, path in paths.items() if path.exists()}
        if not paths:
            yield "Not measured: no such recordings were given (`--cvar`), or they failed."
            yield ""
            return
        yield (
            "Their joints are marked by another convention: mean joint error as it is, and after one "
            "constant offset per joint in the axes of its bone (the default of what follows), the palm, the "
            "camera. Errors are over all frames with truth, lost ones included."
        )
        yield ""
        curves: dict[str, Curve] = {}
        rows = [_cvar_cells(name, path, curves, targets) for name, path in paths.items()]
        errors = ("as it is", *(f"offsets: {axes}" for axes in OFFSET_AXES))
        yield from table(("", *errors, "p95, mm", "tracked", "frames, mean within 20 mm"), rows)
        picture = options.output / "cvar-curve.png"
        pictures.curves(picture, curves)
        yield f"![Share of frames with joint errors below D]({picture.name})"
        yield ""


def _cvar_cells(name: str, path: Path, curves: dict[str, Curve], targets: Targets) -> list[str]:
    plain = evaluate(path)
    without = {axes: evaluate(path, EvalOptions(joint_offsets=axes)) for axes in OFFSET_AXES}  # type: ignore[arg-type]
    best = without[OFFSET_AXES[0]]
    if best.curve is not None:
        curves[name] = best.curve
    errors = [figure_of(one, "joint_error_mm.mean").value or np.nan for one in (plain, *without.values())]
    p95 = figure_of(best, "joint_error_mm.p95").value or np.nan
    within = figure_of(best, "frames_mean_within_20mm").value or 0.0
    targets.add(f"{name}: mean joint error after offsets, mm", "<= 20", f"{errors[1]:.1f}", errors[1] <= 20.0)
    share = best.coverage.share
    targets.add(f"{name}: frames tracked", ">= 90 %", f"{100 * share:.1f} %", share >= 0.9)
    return [name, *(number(e, 1) for e in (*errors, p95)), number(share, 1, True), number(within, 1, True)]
