"""Pictures for reports: the worst frames of a result."""

from __future__ import annotations

from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.evaluation.subjects import KINDS
from posetrack_cli.losses import LossLog
from posetrack_cli.results.reader import read_result

if TYPE_CHECKING:
    from posetrack_cli.evaluation.evaluation import Evaluation
    from posetrack_cli.evaluation.viewing.drawing import Drawer
    from posetrack_cli.evaluation.viewing.layers import Drawing
    from posetrack_cli.evaluation.viewing.view import OpenDevice
    from posetrack_cli.recording.recording import Recording


@dataclass(frozen=True, eq=False)
class Picture:
    """A drawn frame.

    Attributes:
        png: the image file.
        frame_index: position in the recording.
        stamp_ns: when the frame was taken, integer nanoseconds.
        caption: one line: frame, time, what the estimate is like.
    """

    png: bytes
    frame_index: int
    stamp_ns: int
    caption: str


def worst_frame_pictures(
    evaluation: Evaluation, recording: Recording, count: int, device: int | None = None
) -> list[Picture]:
    """Draw the worst frames: the largest error, without truth the lost ones and then the least confidence.

    Each picture shows what was observed, in depth with the estimate right of it, on grey images with the
    estimate on them, the truth in green; all are cut out around the subject and of one size.

    Args:
        evaluation: what was measured.
        recording: what the result was made from (``search_recording``).
        count: how many at most. They are at least a second apart, so a short recording gives fewer.
        device: EGL device index, None for the default, or the processor without OpenGL.

    Returns:
        The worst first. Frames that the recording does not give are left out.

    Raises:
        RenderingError: nothing can be rendered here.
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
    """Return the error (N,) of every frame, NaN without truth, and its name; None where there is none."""
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
    """PNG, frame number and stamp of each row that the recording has a frame of."""
    from posetrack_cli.evaluation.matched_frames import matched_frames
    from posetrack_cli.evaluation.viewing.outputs import png_of
    from posetrack_cli.evaluation.viewing.view import drawer_of, report_panels

    result, track, ordered = read_result(evaluation.path), evaluation.track, np.sort(rows)
    panels = report_panels(result, recording, _drawing(evaluation, rows, drawer_of(result, device)))
    drawn = {}
    numbers = None if track.frame_index is None else track.frame_index[ordered]
    for position, frame in matched_frames(recording, track.stamp_ns[ordered], numbers, LossLog()):
        row = int(ordered[position])
        picture = panels.plain(panels.drawing.at(frame, int(track.stamp_ns[row])))
        drawn[row] = png_of(picture), frame.index, frame.stamp_ns
    return drawn


def _drawing(evaluation: Evaluation, rows: IntArray, drawer: Drawer) -> Drawing:
    from posetrack_cli.evaluation.viewing.colours import TRUTH
    from posetrack_cli.evaluation.viewing.layers import Drawing, DrawnTrack

    track, truth = evaluation.track, evaluation.truth
    return Drawing(
        (DrawnTrack(track, drawer),),
        None if truth is None else DrawnTrack(truth, drawer, TRUTH),
        around=None if track.points is None else track.points[rows],
        still=False,
    )


def caption_of(evaluation: Evaluation, row: int, errors: FloatArray | None, name: str) -> str:
    """Return the line below a picture: frame, time, what the estimate is like."""
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
