"""Points of the skin found again in another crop, and in which crops they are looked for."""

from __future__ import annotations

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry.rotations import angle_between

WINDOW, LEVELS = (15, 15), 1
"""Of the search (Lucas and Kanade 1981, by pyramids: Bouguet 2000)."""
CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.02)
BACK_PX = 0.4
"""A point is found if it is led back to within so much of where it came from."""
FAR_PX = 12.0
"""No point is found so far from where it is expected."""
SEEN_DEG, ALIKE_DEG = 30.0, 22.0
"""Skin looks no more like itself in a view that is turned by more: one near in time, or any other."""


def find_again(
    first: ImageArray, places: FloatArray, second: ImageArray, expected: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Find points of one crop in another.

    Args:
        first: crop.
        places: (N, 2) of the points in it.
        second: crop.
        expected: (N, 2) about where they are in it.

    Returns:
        (N, 2) where they are, and (N,) whether they were found.
    """
    there = places.astype(np.float32)
    guess = expected.astype(np.float32)
    found, forth = _flow(first, second, there, guess, LEVELS)
    again, back = _flow(second, first, found, there, 0)  # it begins where it should end
    near = np.linalg.norm(again - there, axis=1) < BACK_PX
    near &= np.linalg.norm(found - guess, axis=1) < FAR_PX
    return found.astype(np.float64), near & forth & back


def _flow(
    first: ImageArray, second: ImageArray, places: Float32Array, guess: Float32Array, levels: int
) -> tuple[Float32Array, BoolArray]:
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        first,
        second,
        places,
        guess.copy(),
        winSize=WINDOW,
        maxLevel=levels,
        criteria=CRITERIA,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(found, dtype=np.float32), np.asarray(status).ravel() == 1


def views_for(
    quaternion: FloatArray, away_ns: FloatArray, quaternions: FloatArray, near: int, alike: int
) -> list[int]:
    """Return the views in which skin looks about as from a pose: some near in time, some turned as it is.

    Args:
        quaternion: (4,) of the pose.
        away_ns: (n,) of the views in time; inf of one to leave out.
        quaternions: (n, 4) of their poses.
        near, alike: how many, at most.
    """
    turned = np.degrees(angle_between(quaternions, quaternion))
    known = np.isfinite(away_ns)
    by_time = [int(one) for one in np.argsort(away_ns, kind="stable")[:near] if known[one]]
    chosen = [one for one in by_time if turned[one] < SEEN_DEG]
    others = (int(one) for one in np.argsort(turned, kind="stable") if known[one] and one not in chosen)
    return chosen + [one for one in others if turned[one] < ALIKE_DEG][:alike]
