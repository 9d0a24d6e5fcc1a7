"""About where the skin of a face lies between its feature points, to begin with.

Points of the skin get the depths of a smooth surface through the person's ten points and ``ANCHORS``, which
are rough: their depths are then found from the whole recording (``adjustment``).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.head.face.points import EYES, MEAN_SHAPE, MOUTH
from posetrack_cli.head.skin.crops import HEIGHT, WIDTH

ANCHORS = np.array(
    [
        [0.0, 50.0, 8.0],  # forehead
        [-40.0, 45.0, -8.0],
        [40.0, 45.0, -8.0],
        [0.0, 20.0, 22.0],  # between the brows
        [-20.0, 15.0, 18.0],
        [20.0, 15.0, 18.0],
        [-50.0, 20.0, -8.0],  # temples
        [50.0, 20.0, -8.0],
        [-60.0, -10.0, -25.0],
        [60.0, -10.0, -25.0],
        [0.0, -20.0, 38.0],  # ridge of the nose
        [-20.0, -45.0, 18.0],  # cheeks
        [20.0, -45.0, 18.0],
        [-40.0, -40.0, 2.0],
        [40.0, -40.0, 2.0],
        [0.0, -100.0, 5.0],  # chin
    ]
)
"""(n, 3) mm in the head's frame, of a face whose outer corners of the eyes are as far apart as on average."""
SMOOTHING = 30.0
"""Of the surface, mm^2: it passes a few mm beside points that do not fit each other."""
STEP_MM, MOST_STEPS = 2.0, 200
"""Between points of the surface; faces that are larger than any, as a file may say, have no more of them."""
LIDS_MM, LIPS_MM = (26.0, 12.0), (32.0, 14.0)
"""Half the width and height about the middle of an eye and of the mouth, whose skin moves by itself."""
BORDER_PX = 10
"""Points are looked for no nearer to a crop's border."""
QUALITY = 1e-3
"""A corner counts down to so much of the strongest one's smaller eigenvalue."""
BLOCK = 9


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface.

    Attributes:
        points: (n, 3) on it, ``STEP_MM`` apart, where skin moves with the head; mm in the head's frame.
    """

    points: FloatArray

    def corners(self, crop: ImageArray, places: FloatArray, count: int, distance_px: float) -> list[int]:
        """Return which points lie at a crop's clearest corners.

        Args:
            crop: (HEIGHT, WIDTH).
            places: (n, 2) of the points in it.
            count: of corners at most.
            distance_px: between two of them at least.
        """
        low, high = np.array([BORDER_PX, BORDER_PX]), np.array([WIDTH, HEIGHT]) - BORDER_PX
        inside = np.flatnonzero(((places >= low) & (places < high)).all(axis=1))
        if not len(inside):
            return []
        about = np.zeros(crop.shape, dtype=np.uint8)
        columns, rows = places[inside].astype(int).T
        about[rows, columns] = 255
        mask = cv2.dilate(about, np.ones((5, 5), np.uint8))
        found = cv2.goodFeaturesToTrack(crop, count, QUALITY, distance_px, mask=mask, blockSize=BLOCK)
        if found is None:
            return []
        from scipy.spatial import cKDTree  # after the start, as a run of one pass never needs it

        _, nearest = cKDTree(places[inside]).query(found[:, 0])
        return [int(one) for one in inside[np.unique(nearest)]]


def surface_of(shape: FloatArray) -> Surface:
    """Return the surface of a face with ten points (K, 3), mm in the head's frame."""
    from scipy.interpolate import RBFInterpolator  # as above; it takes half a second

    size = (shape[3, 0] - shape[0, 0]) / (MEAN_SHAPE[3, 0] - MEAN_SHAPE[0, 0])
    known = np.vstack([shape, size * ANCHORS])
    depth = RBFInterpolator(known[:, :2], known[:, 2], smoothing=SMOOTHING)
    (left, low), (right, high) = known[:, :2].min(axis=0), known[:, :2].max(axis=0)
    step = max(STEP_MM, (right - left) / MOST_STEPS, (high - low) / MOST_STEPS)
    across, along = np.meshgrid(np.arange(left, right, step), np.arange(low, high, step))
    places = np.column_stack([across.ravel(), along.ravel()])
    outline = cv2.convexHull(known[:, :2].astype(np.float32))
    kept = np.array([cv2.pointPolygonTest(outline, (float(x), float(y)), False) >= 0.0 for x, y in places])
    for middle, half in (
        (shape[EYES][:2].mean(axis=0), LIDS_MM),
        (shape[EYES][2:].mean(axis=0), LIDS_MM),
        (shape[MOUTH].mean(axis=0), LIPS_MM),
    ):
        kept &= (np.abs(places - middle[:2]) >= size * np.array(half)).any(axis=1)
    places = places[kept]
    return Surface(np.column_stack([places, depth(places)]))
