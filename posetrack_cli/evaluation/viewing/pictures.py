"""Pictures of the worst frames for the HTML report."""

from __future__ import annotations

from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.evaluation.measuring.subjects import KINDS
from posetrack_cli.losses import LossLog
from posetrack_cli.results.reader import read_result

if TYPE_CHECKING:
    from posetrack_cli.evaluation.measuring.evaluation import Evaluation
    from posetrack_cli.evaluation.viewing.drawing import Drawer
    from posetrack_cli.evaluation.viewing.layers import Drawing
    from posetrack_cli.evaluation.viewing.view import OpenDevice
    from posetrack_cli.recording.recording import Recording


@dataclass(frozen=True, eq=False)
class Picture:
    """Picture of a frame.

    Attributes:
        png: PNG file.
        frame_index: frame number in the recording.
        stamp_ns: stamp of the frame, ns.
        caption: frame, time, status and error in one line.
    """

    png: bytes
    frame_index: int
    stamp_ns: int
    caption: str


def worst_frame_pictures(
    evaluation: Evaluation, recording: Recording, count: int, device: int | None = None
) -> list[Picture]:
    """Draw the worst frames (``worst_rows``), with the ground truth in green.

    Pictures are cropped around the subject and have the same size. Depth images are shown next to the
    estimate, grey images below it.

    Args:
        evaluation: the evaluation, with tracks.
        recording: recording of the result (``search_recording``).
        count: maximum number of pictures; fewer for short recordings.
        device: EGL device index; None for the default device, or the CPU without OpenGL.

    Returns:
        Pictures, worst first, without frames that the recording does not have.

    Raises:
        RenderingError: no renderer is available.
        ResultError, UsageError: the result cannot be drawn on these images.
    """
    from posetrack_cli.evaluation.viewing.frame_choice import worst_rows
    from posetrack_cli.rendering.devices import open_usual_device

    errors, name = errors_of(evaluation)
    rows = worst_rows(evaluation.track, errors, count)
    if not rows.size:
        return []
    with ExitStack() as opened:
        drawn = _drawn(
            evaluation, recording, rows, lambda: opened.enter_context(closing(open_usual_device(device)))
        )
    kept = [int(row) for row in rows if int(row) in drawn]
    return [Picture(*drawn[row], caption_of(evaluation, row, errors, name)) for row in kept]


def errors_of(evaluation: Evaluation) -> tuple[FloatArray | None, str]:
    """Return the errors (N,) of all frames, NaN without ground truth, and their name; None without errors."""
    kind = KINDS[evaluation.subject]
    found = next((name for name in kind.worst_by if name in evaluation.series), None)
    if found is None or evaluation.pairs is None:
        return None, ""
    errors = np.full(len(evaluation.track), np.nan)
    errors[evaluation.pairs.estimate] = evaluation.series[found]
    return errors, next(metric.label for metric in kind.metrics if metric.name == found)


def _drawn(
    evaluation: Evaluation, recording: Recording, rows: IntArray, device: OpenDevice
) -> dict[int, tuple[bytes, int, int]]:
    """Return PNG, frame number and stamp of the rows whose frame is in the recording."""
    from posetrack_cli.evaluation.reading.tracks import matched_frames
    from posetrack_cli.evaluation.viewing.outputs import png_of
    from posetrack_cli.evaluation.viewing.view import drawer_of, report_panels

    result, track, ordered = (
        read_result(evaluation.path).of(evaluation.label),
        evaluation.track,
        np.sort(rows),
    )
    panels = report_panels(result, recording, _drawing(evaluation, rows, drawer_of(result, device)))
    drawn = {}
    numbers = None if track.frame_index is None else track.frame_index[ordered]
    for position, frame in matched_frames(recording, track.stamp_ns[ordered], numbers, LossLog()):
        row = int(ordered[position])
        picture = panels.plain(panels.drawing.at(frame, int(track.stamp_ns[row])))
        drawn[row] = png_of(picture), frame.index, frame.stamp_ns
    return drawn


def _drawing(evaluation: Evaluation, rows: IntArray, drawer: Drawer) -> Drawing:
    from posetrack_cli.evaluation.viewing.drawing import TRUTH
    from posetrack_cli.evaluation.viewing.layers import Drawing, DrawnTrack

    track, truth = evaluation.track, evaluation.truth
    return Drawing(
        (DrawnTrack(track, drawer),),
        () if truth is None else (DrawnTrack(truth, drawer, TRUTH),),
        around=None if track.points is None else track.points[rows],
        still=False,
    )


def caption_of(evaluation: Evaluation, row: int, errors: FloatArray | None, name: str) -> str:
    """Return the caption of a picture: frame, time, status, error, confidence or cost."""
    track = evaluation.track
    seconds = 1e-9 * int(track.stamp_ns[row] - track.stamp_ns[0])
    number = row if track.frame_index is None else int(track.frame_index[row])
    words = [f"frame {number}", f"{seconds:.3f} s"]
    if track.lost is not None:
        words.append(track.status(row).value)
    if errors is not None:
        words.append(f"{name} {errors[row]:.1f} mm")
    if track.confidence is not None and np.isfinite(track.confidence[row]):
        words.append(f"confidence {track.confidence[row]:.2f}")
    if errors is None and track.cost is not None and np.isfinite(track.cost[row]):
        words.append(f"cost {track.cost[row]:.1f} mm")
    return ", ".join(words)
