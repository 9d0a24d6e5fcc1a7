"""Motion of a whole face between frames, for heads that move farther than a patch reaches **[ours]**.

After an unexpected motion the points lock onto similar places near the predicted pose. A blurred or turned
face, or one with a new expression, resembles its templates nowhere, but it resembles the previous frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray, IntArray
from posetrack_cli.geometry.rotations import quaternions_from_matrices
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.face.rig_images import RigImages, project
from posetrack_cli.head.face.templates import WINDOW, TemplateSet
from posetrack_cli.head.initialisation.single_view import pose_near
from posetrack_cli.head.particles.particles import velocity_between
from posetrack_cli.head.tracker.frame_tracker import FrameFit, TrackState

WHOLE_FACE_CORRELATION = 0.4
"""Minimum mean correlation of a face's windows between two frames of the same face."""
SCORE_DECAY, SAME_FACE_CORRELATION = 0.98, 0.8
"""Factor on the score after each frame followed only from the previous one, and the mean correlation of equal
faces; between a sharp and a blurred frame it is not higher."""
Refit = Callable[[TrackState, Sequence[TemplateSet] | None], FrameFit]
"""Fits a frame from a track, to given templates or, by default, the stored ones."""


def whole_face_fit(
    fit: FrameFit, track: TrackState, images: RigImages, refit: Refit, *, clear: float, trust: float
) -> FrameFit:
    """Return a fit, or for a poor one a better fit from the whole face's motion.

    The score of a fit to the previous frame is that frame's score times their similarity, so that a sliding
    track loses confidence over time.

    Args:
        fit: of the frame.
        track: after the previous frame.
        images: of the frame.
        refit: fits the frame again.
        clear: score from which a fit is kept; the search costs several fits.
        trust: score of the previous frame.
    """
    if fit.score >= clear or track.templates is None:
        return fit
    there = whole_face_pose(track, images)
    if there is None:
        return fit
    about = replace(track.at_rest(), pose=there, particles=replace(track.particles, pose=there))
    again = _moving(refit(about, None), track)
    # compare weights, not scores: the score ignores points outside the image
    best = again if again.weights.mean() > fit.weights.mean() else fit
    if best.score >= clear:
        return best
    followed = _moving(refit(about, (track.templates,)), track)
    alike = float(np.clip(followed.score / SAME_FACE_CORRELATION, 0.0, 1.0))
    score = SCORE_DECAY * trust * alike
    if score <= best.score:
        return best
    weights = np.minimum(followed.weights, best.weights)  # the previous frame may have been wrong already
    return replace(followed, score=score, weights=weights, is_anchored=True)


def _moving(fit: FrameFit, before: TrackState) -> FrameFit:
    """Return a fit with the velocity since the previous frame."""
    velocity = velocity_between(before.pose, fit.track.pose, fit.dt)
    return replace(fit, track=replace(fit.track, velocity=velocity))


def whole_face_pose(track: TrackState, images: RigImages) -> HeadPose | None:
    """Return the pose after the motion of the whole face in the images; None if it is not found.

    The common shift comes first; the individual places of the points then give rotation and distance. Of
    several cameras, the one with the most similar face counts.
    """
    if track.templates is None:
        return None
    before = project(images.cameras, track.pose.points(track.shape)).pixels
    shifts = [
        None if image is None else shift_of(image, track.templates, before[c], c)
        for c, image in enumerate(images.images)
    ]
    c, shift = max(enumerate(shifts), key=lambda pair: -1.0 if pair[1] is None else pair[1].likeness)
    if shift is None or shift.likeness < WHOLE_FACE_CORRELATION:
        return None
    camera = images.cameras[c]
    transform = np.array(camera.camera_T_reference)
    R, t = transform[:, :3], transform[:, 3]
    own = _transformed(track.pose, R, t)
    aside = shift.pixels / np.array([camera.fx, camera.fy]) * own.position[2]
    moved = replace(own, position=own.position + np.append(aside, 0.0))
    there = pose_near(moved, shift.places, shift.likenesses, camera, track.shape)
    return _transformed(there, R.T, -R.T @ t)


def _transformed(pose: HeadPose, R: FloatArray, t: FloatArray) -> HeadPose:
    """Return a pose in other axes; unchanged, bit by bit, in the same."""
    if np.array_equal(R, np.eye(3)):
        return replace(pose, position=pose.position + t)
    return HeadPose(R @ pose.position + t, quaternions_from_matrices(R @ pose.rotation))


# The shift is the one with the best mean correlation of all windows of the previous frame, which together
# cover most of the face. Each window may deviate from it by ``SLACK``; the individual best places then show
# rotation and approach.

REDUCED = 2
"""Image reduction: a start needs no full resolution."""
REACH_PX = 96
"""Longest shift along an axis: slightly more than the eye distance in scaled images."""
SLACK = 5
"""Reduced pixels by which a point may deviate from the common shift along an axis: an eighth of the eye
distance, as in a turn by some 20 degrees within a frame."""


class Shift(NamedTuple):
    """Motion of a face in the image.

    Attributes:
        pixels: (2,) x and y.
        likeness: mean correlation there, -1 to 1, each window's best within the slack.
        places: (K, 2) pixels of the points' own best places; NaN for points not seen before.
        likenesses: (K,) their correlations; 0 if negative or not seen before.
    """

    pixels: FloatArray
    likeness: float
    places: FloatArray
    likenesses: FloatArray


def shift_of(image: ImageArray, templates: TemplateSet, pixels: FloatArray, camera: int = 0) -> Shift | None:
    """Find the motion of a face since the previous frame; None if none of its points was seen there.

    Args:
        image: (height, width) grey.
        templates: of the previous frame.
        pixels: (K, 2) of the points in it.
        camera: index of the image's camera.
    """
    seen = np.flatnonzero(templates.seen[camera])
    if not len(seen):
        return None
    # replicated borders keep the correlation maps of all points the same size
    margin = (REACH_PX + WINDOW) // REDUCED
    small = cv2.resize(image, None, fx=1.0 / REDUCED, fy=1.0 / REDUCED, interpolation=cv2.INTER_AREA)
    wide = cv2.copyMakeBorder(small, margin, margin, margin, margin, cv2.BORDER_REPLICATE)
    corners = np.rint((pixels - templates.centres[camera]) / REDUCED).astype(int)
    corners = np.clip(corners, 0, np.array(small.shape[::-1]) - WINDOW // REDUCED)
    each = [_likeness(wide, templates.windows[camera, k], corners[k] + margin) for k in seen]
    near = np.ones((2 * SLACK + 1, 2 * SLACK + 1), np.uint8)  # dilation takes each map's maximum within it
    mean = np.mean([cv2.dilate(one, near) for one in each], axis=0)
    roughly = np.array(np.unravel_index(int(np.argmax(mean)), mean.shape))
    middle = np.rint(np.median(_best_near(each, roughly), axis=0)).astype(int)
    places, likenesses = np.full(pixels.shape, np.nan), np.zeros(len(pixels))
    best = _best_near(each, middle)
    places[seen] = pixels[seen] + _moved(best)
    likenesses[seen] = [
        max(float(one[row, column]), 0.0) for one, (row, column) in zip(each, best, strict=True)
    ]
    return Shift(_moved(middle), float(mean[tuple(roughly)]), places, likenesses)


def _best_near(each: Sequence[Float32Array], place: IntArray) -> IntArray:
    """Return the row and column (n, 2) of the maximum of each map within the slack of a place."""
    first, found = np.maximum(place - SLACK, 0), []
    for one in each:
        part = one[first[0] : place[0] + SLACK + 1, first[1] : place[1] + SLACK + 1]
        found.append(first + np.unravel_index(int(np.argmax(part)), part.shape))
    return np.array(found)


def _moved(places: IntArray) -> FloatArray:
    """Convert rows and columns of a correlation map to shifts (..., 2), pixels along x and y."""
    shifts: FloatArray = REDUCED * places[..., ::-1].astype(np.float64) - REACH_PX
    return shifts


def _likeness(wide: ImageArray, window: ImageArray, corner: IntArray) -> Float32Array:
    """Return the correlations of a window with an image for all shifts from its corner."""
    side, reach = WINDOW // REDUCED, REACH_PX // REDUCED
    template = cv2.resize(window, (side, side), interpolation=cv2.INTER_AREA)
    left, top = int(corner[0]) - reach, int(corner[1]) - reach
    around = wide[top : top + side + 2 * reach, left : left + side + 2 * reach]
    return np.asarray(cv2.matchTemplate(around, template, cv2.TM_CCOEFF_NORMED), dtype=np.float32)
