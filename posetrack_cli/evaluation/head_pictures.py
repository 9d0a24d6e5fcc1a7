"""Pictures for reports: the worst frames of a head's result."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posetrack_cli.evaluation.pictures import Picture, errors_of, said_of

if TYPE_CHECKING:
    from posetrack_cli.arrays import IntArray
    from posetrack_cli.evaluation.evaluation import Evaluation
    from posetrack_cli.evaluation.viewing.head_panels import HeadPanels
    from posetrack_cli.evaluation.viewing.layers import Layer
    from posetrack_cli.recording.recording import Recording


def worst_head_pictures(evaluation: Evaluation, recording: Recording, count: int) -> list[Picture]:
    """Draw the worst frames as ``worst_frame_pictures`` does: the face in every camera, the truth green.

    Args:
        evaluation: what was measured.
        recording: the images that the result was made from (``search_recording``).
        count: how many at most.

    Returns:
        The worst first. Frames that the recording does not give are left out.

    Raises:
        UsageError: the result's cameras cannot have taken these images.
    """
    from posetrack_cli.evaluation.viewing.frame_choice import worst_rows

    errors, name = errors_of(evaluation)
    rows = worst_rows(evaluation.track, errors, count)
    if not rows.size:
        return []
    drawn = _drawn(evaluation, recording, rows)
    kept = [int(row) for row in rows if int(row) in drawn]
    return [Picture(*drawn[row], said_of(evaluation, row, errors, name)) for row in kept]


def _drawn(evaluation: Evaluation, recording: Recording, rows: IntArray) -> dict[int, tuple[bytes, int, int]]:
    """PNG, frame number and stamp of each row that the recording has a frame of."""
    from posetrack_cli.evaluation.matched_images import matched_images
    from posetrack_cli.evaluation.viewing.outputs import png_of
    from posetrack_cli.losses import LossLog

    track, ordered, drawn = evaluation.track, np.sort(rows), {}
    panels, layer = _panels(evaluation, recording, rows)
    numbers = None if track.frame_index is None else track.frame_index[ordered]
    for position, frame in matched_images(recording, track.stamp_ns[ordered], numbers, LossLog()):
        row = int(ordered[position])
        around = None if track.points is None else track.points[row]
        picture = panels.body(frame, int(track.stamp_ns[row]), around, layer)
        drawn[row] = png_of(picture), frame.index, frame.stamp_ns
    return drawn


def _panels(evaluation: Evaluation, recording: Recording, rows: IntArray) -> tuple[HeadPanels, Layer]:
    from posetrack_cli.evaluation.recording_of import cameras_of
    from posetrack_cli.evaluation.viewing.colours import TRUTH
    from posetrack_cli.evaluation.viewing.head_panels import HeadPanels, drawer_of_head
    from posetrack_cli.evaluation.viewing.layers import Layer
    from posetrack_cli.results.reader import read_result

    result, track, truth = read_result(evaluation.path), evaluation.track, evaluation.truth
    layer = Layer(track, drawer_of_head(result))
    true = None if truth is None else Layer(truth, layer.drawer, TRUTH)
    around = None if track.points is None else track.points[rows]
    cameras = cameras_of(result, recording)
    return HeadPanels(cameras, [layer], true, around=around, still=False), layer
