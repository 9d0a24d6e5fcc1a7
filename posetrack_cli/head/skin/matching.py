"""Skin in images: upright crops, its surface, and matches between crops."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera, pixels_wherever
from posetrack_cli.geometry.rotations import angle_between
from posetrack_cli.head.adjustment.adjuster import PointView
from posetrack_cli.head.face.points import EYES, MEAN_SHAPE, MOUTH, HeadPose

# Upright crops of faces at one size, and the selection of those kept by a first pass.
#
# Lighting does not move with the skin, so smooth shading biases the motion towards zero. Crops therefore
# contain only detail finer than ``FINE_PX``.

WIDTH, HEIGHT = 176, 208
"""Size of a crop, from the forehead to the chin."""
PX_PER_MM = 1.25
"""Scale of a crop: an eye distance of 80 pixels."""
MIDDLE = np.array([0.0, -20.0, 15.0])
"""(3,) centre of a crop, in the head's frame, mm: the bridge of the nose."""
FINE_PX, GREY, CONTRAST = 4.0, 128.0, 2.0
"""Standard deviation of the blur that is subtracted, and offset and gain of the rest in eight bits."""

EVERY_NS = 250_000_000
"""Initial minimum time between two stored frames."""
SOONEST, TURNED_DEG = 0.25, 10.0
"""Factor on it while the head turns by this angle."""
MOST_VIEWS = 120
"""Maximum number of stored frames; beyond, every second one is dropped."""


@dataclass(frozen=True, eq=False)
class SkinView:
    """A frame for the skin map.

    Attributes:
        view: its feature points and their pose.
        crops: (C, HEIGHT, WIDTH) fine detail in each camera's image.
        placements: (C, 2, 3) from pixels of the crops to those of the images.
    """

    view: PointView
    crops: ImageArray
    placements: FloatArray

    def rescaled(self, ratio: float) -> SkinView:
        """Return the view for an image scaled by a ratio."""
        placements = ratio * self.placements
        placements[..., 2] += 0.5 * (ratio - 1.0)
        return replace(self, view=self.view.rescaled(ratio), placements=placements)


@dataclass(frozen=True, eq=False)
class SkinAlbum:
    """Stored frames, evenly spaced in time, and denser while the head turns.

    Attributes:
        views: in the order of time.
        every_ns: minimum time between two of them, ``SOONEST`` of it while the head turns; 0 without frames.
    """

    views: tuple[SkinView, ...] = ()
    every_ns: int = 0

    def wants(self, stamp_ns: int, pose: HeadPose, turned_deg: float = TURNED_DEG) -> bool:
        """Whether a frame is late enough after the last one; sooner if the head turned by an angle."""
        if not self.views:
            return True
        last = self.views[-1].view
        turned = np.degrees(angle_between(last.pose.quaternion, pose.quaternion)) >= turned_deg
        return stamp_ns - last.stamp_ns >= (SOONEST if turned else 1.0) * self.every_ns

    def with_view(self, view: SkinView, most: int) -> SkinAlbum:
        """Return the album with a frame; beyond ``most``, every second one is dropped and the interval
        doubled.
        """
        views, every_ns = (*self.views, view), self.every_ns or EVERY_NS
        return SkinAlbum(views, every_ns) if len(views) <= most else SkinAlbum(views[::2], 2 * every_ns)

    def rescaled(self, ratio: float) -> SkinAlbum:
        """Return the frames for images scaled by a ratio."""
        return replace(self, views=tuple(one.rescaled(ratio) for one in self.views))


def place_crop(camera: Camera, pose: HeadPose) -> FloatArray:
    """Return (2, 3), the similarity transform from pixels of a crop to pixels of an image.

    The pose is in the camera's axes. The rotation is arbitrary for a head along the camera's x axis, which
    has no upright direction.
    """
    middle = pose.points(MIDDLE)
    centre, right = pixels_wherever(camera, np.stack([middle, middle + pose.rotation[:, 0]]))
    across = right - centre
    angle = float(np.arctan2(across[1], across[0]))
    scale = 0.5 * (camera.fx + camera.fy) / max(float(middle[2]), 1.0) / PX_PER_MM
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.column_stack([turn, centre - turn @ [WIDTH / 2, HEIGHT / 2]])


def cut(image: ImageArray, placement: FloatArray) -> ImageArray:
    """Return the crop (HEIGHT, WIDTH) of a grey image, with replicated borders."""
    warp = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    raw = cv2.warpAffine(image, placement, (WIDTH, HEIGHT), flags=warp, borderMode=cv2.BORDER_REPLICATE)
    fine = raw.astype(np.float32)
    fine -= cv2.GaussianBlur(fine, (0, 0), FINE_PX)
    kept: ImageArray = np.clip(GREY + CONTRAST * fine, 0.0, 255.0).astype(np.uint8)
    return kept


def to_image(placement: FloatArray, places: FloatArray) -> FloatArray:
    """Convert places (..., 2) in a crop to pixels of its image."""
    pixels: FloatArray = places @ placement[:, :2].T + placement[:, 2]
    return pixels


def to_crop(placement: FloatArray, pixels: FloatArray) -> FloatArray:
    """Convert pixels (..., 2) of an image to places in its crop."""
    places: FloatArray = (pixels - placement[:, 2]) @ np.linalg.inv(placement[:, :2]).T
    return places


# Initial surface of the skin: smooth, through the person's ten points and the rough ``ANCHORS``. The depths
# are then adjusted over the whole recording (``equations``).

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
"""(n, 3) mm in the head's frame, for a face with an average distance of the outer eye corners."""
SMOOTHING = 30.0
"""Of the surface, mm^2: it may miss inconsistent points by a few mm."""
STEP_MM, MOST_STEPS = 2.0, 200
"""Spacing of surface points, and limit of their number along an axis, for implausible faces in files."""
LIDS_MM, LIPS_MM = (26.0, 12.0), (32.0, 14.0)
"""Half width and height of the excluded regions around eyes and mouth, where the skin moves by itself."""
BORDER_PX = 10
"""Minimum distance of points from a crop's border."""
QUALITY = 1e-3
"""Minimum corner strength (smaller eigenvalue) relative to the strongest corner."""
BLOCK = 9


@dataclass(frozen=True, eq=False)
class Surface:
    """Surface of a face.

    Attributes:
        points: (n, 3) on it, ``STEP_MM`` apart, where skin moves with the head; mm in the head's frame.
    """

    points: FloatArray

    def corners(self, crop: ImageArray, places: FloatArray, count: int, distance_px: float) -> list[int]:
        """Return the indices of the points at a crop's strongest corners.

        Args:
            crop: (HEIGHT, WIDTH).
            places: (n, 2) of the points in it.
            count: maximum number of corners.
            distance_px: minimum distance between two of them.
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
        from scipy.spatial import cKDTree  # imported late: single-pass runs never need it

        _, nearest = cKDTree(places[inside]).query(found[:, 0])
        return [int(one) for one in inside[np.unique(nearest)]]


def surface_of(shape: FloatArray) -> Surface:
    """Return the surface of a face with ten points (K, 3), mm in the head's frame."""
    from scipy.interpolate import RBFInterpolator  # imported late: takes half a second

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


# Matching of skin points between crops, and selection of similar views

WINDOW, LEVELS = (15, 15), 1
"""Of the pyramidal Lucas-Kanade tracker (Lucas and Kanade 1981; Bouguet 2000)."""
CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.02)
BACK_PX = 0.4
"""Maximum forward-backward error."""
FAR_PX = 12.0
"""Maximum distance from the expected place."""
SEEN_DEG, ALIKE_DEG = 30.0, 22.0
"""Maximum rotation between matched views: near in time, or any others."""


def track_points(
    first: ImageArray, places: FloatArray, second: ImageArray, expected: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Track points from one crop to another.

    Args:
        first: crop.
        places: (N, 2) of the points in it.
        second: crop.
        expected: (N, 2) approximate places in it.

    Returns:
        (N, 2) places in the second crop, and (N,) whether they were found.
    """
    there = places.astype(np.float32)
    guess = expected.astype(np.float32)
    found, forth = _flow(first, second, there, guess, LEVELS)
    again, back = _flow(second, first, found, there, 0)  # no pyramid: it starts at the expected result
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
    """Return views in which skin looks similar: some near in time, some of similar rotation.

    Args:
        quaternion: (4,) of the pose.
        away_ns: (n,) time differences of the views; inf to exclude one.
        quaternions: (n, 4) of their poses.
        near, alike: maximum numbers.
    """
    turned = np.degrees(angle_between(quaternions, quaternion))
    known = np.isfinite(away_ns)
    by_time = [int(one) for one in np.argsort(away_ns, kind="stable")[:near] if known[one]]
    chosen = [one for one in by_time if turned[one] < SEEN_DEG]
    others = (int(one) for one in np.argsort(turned, kind="stable") if known[one] and one not in chosen)
    return chosen + [one for one in others if turned[one] < ALIKE_DEG][:alike]
