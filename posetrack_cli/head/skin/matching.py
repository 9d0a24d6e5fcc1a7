"""A head's skin in an image: its surface, crops of it, what they match."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera, pixels_wherever
from posetrack_cli.geometry.rotations import angle_between
from posetrack_cli.head.adjustment.adjuster import PointView
from posetrack_cli.head.face.points import EYES, MEAN_SHAPE, MOUTH, HeadPose

# Faces cut out upright and at one size, and which of them a first pass keeps.
#
# Lighting stays where it is while skin turns through it: a cheek that is brighter on one side looks as if it
# moved less than it did. So crops keep only what is finer than ``FINE_PX``; with all of it rendered heads
# were said to nod by .75 to .9 of what they did.


WIDTH, HEIGHT = 176, 208
"""Of a crop, from the forehead to the chin."""
PX_PER_MM = 1.25
"""Eyes come 80 pixels apart. With 1 or 1.6 rendered and real heads came out alike."""
MIDDLE = np.array([0.0, -20.0, 15.0])
"""(3,) of a crop, in the head's frame, mm: the bridge of the nose."""
FINE_PX, GREY, CONTRAST = 4.0, 128.0, 2.0
"""Deviation of the blur that is taken away, and how the rest is kept in eight bits."""

EVERY_NS = 250_000_000
"""Between two frames kept, at first ..."""
SOONEST, TURNED_DEG = 0.25, 10.0
"""... and this share of it where the head turned by so much."""
MOST_VIEWS = 120
"""Of more frames kept every second goes."""


@dataclass(frozen=True, eq=False)
class SkinView:
    """A frame as it shows the skin.

    Attributes:
        view: its feature points, and the pose that they tell.
        crop: (HEIGHT, WIDTH) fine detail.
        placement: (2, 3) from pixels of the crop to those of the image.
    """

    view: PointView
    crop: ImageArray
    placement: FloatArray

    def rescaled(self, ratio: float) -> SkinView:
        """Return the frame as an image shows it that is so many times as large."""
        placement = ratio * self.placement
        placement[:, 2] += 0.5 * (ratio - 1.0)
        return replace(self, view=self.view.rescaled(ratio), placement=placement)


@dataclass(frozen=True, eq=False)
class SkinAlbum:
    """Frames kept, evenly in time, and more of them while the head turns.

    Attributes:
        views: in the order of their time.
        every_ns: between two of them, at least; ``SOONEST`` of it where the head turned.
    """

    views: tuple[SkinView, ...] = ()
    every_ns: int = 0

    def wants(self, stamp_ns: int, pose: HeadPose, turned_deg: float = TURNED_DEG) -> bool:
        """Whether a frame is late enough after the last one kept: sooner if the head turned by so much."""
        if not self.views:
            return True
        last = self.views[-1].view
        turned = np.degrees(angle_between(last.pose.quaternion, pose.quaternion)) >= turned_deg
        return stamp_ns - last.stamp_ns >= (SOONEST if turned else 1.0) * self.every_ns

    def with_view(self, view: SkinView, most: int) -> SkinAlbum:
        """Return the album with a frame; of more than ``most`` every second goes, and stays away."""
        views = (*self.views, view)
        if len(views) <= most:
            return replace(self, views=views)
        return SkinAlbum(views[::2], 2 * self.every_ns)

    def rescaled(self, ratio: float) -> SkinAlbum:
        """Return the same frames as images show them that are so many times as large."""
        return replace(self, views=tuple(one.rescaled(ratio) for one in self.views))


def place_crop(camera: Camera, pose: HeadPose) -> FloatArray:
    """Return (2, 3), from pixels of a crop to pixels of an image: turned, scaled and moved, not sheared.

    A head that looks along the camera's x axis, which has no upright in the image, is taken as it is.
    """
    middle = pose.points(MIDDLE)
    centre, beside = pixels_wherever(camera, np.stack([middle, middle + pose.rotation[:, 0]]))
    across = beside - centre
    angle = float(np.arctan2(across[1], across[0]))
    scale = 0.5 * (camera.fx + camera.fy) / max(float(middle[2]), 1.0) / PX_PER_MM
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.column_stack([turn, centre - turn @ [WIDTH / 2, HEIGHT / 2]])


def cut(image: ImageArray, placement: FloatArray) -> ImageArray:
    """Return the crop (HEIGHT, WIDTH) of a grey image; beyond its border as at the border."""
    warp = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    raw = cv2.warpAffine(image, placement, (WIDTH, HEIGHT), flags=warp, borderMode=cv2.BORDER_REPLICATE)
    fine = raw.astype(np.float32)
    fine -= cv2.GaussianBlur(fine, (0, 0), FINE_PX)
    kept: ImageArray = np.clip(GREY + CONTRAST * fine, 0.0, 255.0).astype(np.uint8)
    return kept


def to_image(placement: FloatArray, places: FloatArray) -> FloatArray:
    """Return the pixels (..., 2) of an image at places (..., 2) of its crop."""
    pixels: FloatArray = places @ placement[:, :2].T + placement[:, 2]
    return pixels


def to_crop(placement: FloatArray, pixels: FloatArray) -> FloatArray:
    """Return the places (..., 2) in a crop of pixels (..., 2) of its image."""
    places: FloatArray = (pixels - placement[:, 2]) @ np.linalg.inv(placement[:, :2]).T
    return places


# About where the skin of a face lies between its feature points, to begin with.
#
# Points of the skin get the depths of a smooth surface through the person's ten points and ``ANCHORS``, which
# are rough: their depths are then found from the whole recording (``equations``).


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


# Points of the skin found again in another crop, and in which crops they are looked for


WINDOW, LEVELS = (15, 15), 1
"""Of the search (Lucas and Kanade 1981, by pyramids: Bouguet 2000)."""
CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.02)
BACK_PX = 0.4
"""A point is found if it is led back to within so much of where it came from."""
FAR_PX = 12.0
"""No point is found so far from where it is expected."""
SEEN_DEG, ALIKE_DEG = 30.0, 22.0
"""Skin looks no more like itself in a view that is turned by more: one near in time, or any other."""


def track_points(
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
