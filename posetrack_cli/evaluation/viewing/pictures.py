"""Pictures of the worst frames for the HTML report, and of face models."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray, IntArray
from posetrack_cli.evaluation.measuring.subjects import KINDS
from posetrack_cli.evaluation.viewing.drawing import SKIN, TEXT, Captions, Colour
from posetrack_cli.head.face.points import LINES, POINT_NAMES
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.losses import LossLog
from posetrack_cli.results.reader import read_result

if TYPE_CHECKING:
    from posetrack_cli.evaluation.measuring.evaluation import Evaluation
    from posetrack_cli.evaluation.viewing.drawing import Drawer
    from posetrack_cli.evaluation.viewing.layers import Drawing
    from posetrack_cli.evaluation.viewing.view import OpenDevice
    from posetrack_cli.recording.recording import Recording


# Face model: identities in rows, deformations in columns (thesis, figure 4.6)


IDENTITY_AXES, DEFORMATION_AXES = 2, 3
"""Maximum numbers of axes to draw."""
DEVIATIONS = 2.0
PIXELS_PER_MM = 1.6
_FRONT_MM, _SIDE_MM, _HEIGHT_MM = 116.0, 84.0, 148.0
_FRONT_X_MM, _SIDE_Z_MM, _TOP_MM = -58.0, -24.0, 44.0
_RIGHT = [POINT_NAMES.index(f"right_{name}") for name in ("eye_outer", "eye_inner", "brow_inner", "nostril")]
_RIGHT.append(POINT_NAMES.index("right_mouth_corner"))
# Indices into _RIGHT: the eye, and the profile from brow over nose to mouth.
_SIDE_LINES = ((0, 1), (2, 3), (3, 4))
_GROUND: Colour = (24, 24, 24)
_MEAN: Colour = (95, 95, 95)
_BITS = 4
Numbered = tuple[str, FloatArray]


def face_model_picture(model: FaceModel) -> ImageArray:
    """Draw faces (height, width, 3) from the front and the right, over the mean face in grey.

    The first row is the mean identity, the others are ``DEVIATIONS`` standard deviations along the axes that
    change the face most; likewise the columns for deformations.
    """
    neutral = model.shapes(model.identity_mean, model.deformation_mean)
    identities = _along(model.identity_mean, model.identity_deviations, _identity_reach(model), "s")
    deformations = _along(
        model.deformation_mean, model.deformation_deviations, _deformation_reach(model), "a"
    )
    rows = [
        np.hstack([_cell(model.shapes(s, a), neutral, f"{of_s}  {of_a}") for of_a, a in deformations])
        for of_s, s in identities
    ]
    return np.vstack(rows)


def _identity_reach(model: FaceModel) -> FloatArray:
    """Return the displacement (S,) of the points by one standard deviation, mm, at the mean deformation."""
    moved = np.einsum("kisa,a->kis", model.core, model.deformation_mean) * model.identity_deviations
    reach: FloatArray = np.linalg.norm(moved, axis=(0, 1))
    return reach


def _deformation_reach(model: FaceModel) -> FloatArray:
    moved = np.einsum("kisa,s->kia", model.core, model.identity_mean) * model.deformation_deviations
    reach: FloatArray = np.linalg.norm(moved, axis=(0, 1))
    return reach


def _along(mean: FloatArray, deviations: FloatArray, reach: FloatArray, name: str) -> Sequence[Numbered]:
    """Return the mean and both directions along the axes with the largest displacement, with captions."""
    shown = [(f"{name} mean", mean)]
    most = IDENTITY_AXES if name == "s" else DEFORMATION_AXES
    for axis in np.argsort(-reach, kind="stable")[:most].tolist():
        for sign in (1.0, -1.0):
            moved = mean.copy()
            moved[axis] += sign * DEVIATIONS * deviations[axis]
            shown.append((f"{name}{axis + 1} {sign * DEVIATIONS:+g} sd", moved))
    return shown


def _cell(shape: FloatArray, neutral: FloatArray, text: str) -> ImageArray:
    """Draw a face from the front and the right, with a caption."""
    width, height = (round(PIXELS_PER_MM * mm) for mm in (_FRONT_MM + _SIDE_MM, _HEIGHT_MM))
    picture = np.full((height, width, 3), _GROUND, np.uint8)
    for points, colour in ((neutral, _MEAN), (shape, SKIN)):
        _draw(picture, points[:, [0, 1]] - [_FRONT_X_MM, 0.0], LINES, colour)
        _draw(picture, points[_RIGHT][:, [2, 1]] + [_FRONT_MM - _SIDE_Z_MM, 0.0], _SIDE_LINES, colour)
    named = Captions([[text]], width).below(picture, [([text], TEXT)])
    return np.pad(named, ((0, 3), (0, 3), (0, 0)))


def _draw(picture: ImageArray, places: FloatArray, lines: Sequence[tuple[int, int]], colour: Colour) -> None:
    """Draw points (P, 2), mm to the right and above the origin of the mean face, and lines."""
    pixels = PIXELS_PER_MM * (places * [1.0, -1.0] + [0.0, _TOP_MM])
    fixed = [(int(x), int(y)) for x, y in np.rint(pixels * (1 << _BITS))]
    for start, end in lines:
        cv2.line(picture, fixed[start], fixed[end], colour, 2, cv2.LINE_AA, _BITS)
    for place in fixed:
        cv2.circle(picture, place, 4 << _BITS, colour, -1, cv2.LINE_AA, _BITS)


# Worst frames of a result


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
    from posetrack_cli.evaluation.viewing.drawing import TRUTH
    from posetrack_cli.evaluation.viewing.layers import Drawing, DrawnTrack

    track, truth = evaluation.track, evaluation.truth
    return Drawing(
        (DrawnTrack(track, drawer),),
        None if truth is None else DrawnTrack(truth, drawer, TRUTH),
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
