"""A map of a person's skin, made of a first pass, and where it says that a head is.

Ten feature points of a real face slide: by 2 to 4 % of the eyes' distance, which is 3 to 5 degrees of yaw.
Corners of the skin between them, some hundred in a frame, are matched between frames all over a recording,
and poses and their depths are adjusted together; then a frame's pose is where its skin lies on the map's. On
real faces the skin is nearer to what others say of them, on rendered ones the feature points are, and the
mean of the two is better than either: ``share`` says how far the skin is believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray, IntArray
from posetrack_cli.geometry.camera import Camera, normalised_from_pixels, pixels_wherever
from posetrack_cli.geometry.rotations import canonical, conjugate, mean_quaternion, multiply, rotate
from posetrack_cli.head.adjustment.adjuster import PointView
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.skin.equations import Observations, adjust_pose, adjust_skin, observations
from posetrack_cli.head.skin.matching import (
    PX_PER_MM,
    SkinView,
    cut,
    place_crop,
    surface_of,
    to_crop,
    to_image,
    track_points,
    views_for,
)
from posetrack_cli.opencv import in_one_thread

LEAST_VIEWS = 4
"""A map of fewer says nothing that is not in the frame."""
POINTS, DISTANCE_MM = 40, 9.0
"""Corners of skin in a view, at most, and how far they are apart."""
LINKED = 6
"""They are looked for in so many views near in time, and in as many turned alike."""
ROUNDS, STEPS = 2, 8
"""Poses and points are adjusted to what was found so many times, in so many steps."""
NEAR, ALIKE = 2, 1
"""A frame is compared with so many views near in time, and so many turned alike."""
ERROR_DEG = 1.5
"""The skin's poses err by about so much, on all faces: how far they are believed."""
LEAST_POINTS, ENOUGH_POINTS = 15, 60
"""Points found: so few say nothing, and so many say all that skin can."""
POSE_STEPS = 5


@dataclass(frozen=True, eq=False)
class SkinMap:
    """Views of the skin, and points in them.

    Attributes:
        stamps: (n,) of the views, ns.
        crops: (n, HEIGHT, WIDTH).
        poses: (n) adjusted.
        views: (M,) in which view each point was chosen, in order.
        places: (M, 2) where, in its crop.
        points: (M, 3) adjusted, mm in the head's frame.
        share: 0 to 1, how far a pose by the skin is believed, beside that by feature points.
    """

    stamps: IntArray
    crops: ImageArray
    poses: HeadPose
    views: IntArray
    places: FloatArray
    points: FloatArray
    share: float

    @cached_property
    def bounds(self) -> IntArray:
        """(n + 1,) points of view i are those from bounds[i] up to bounds[i + 1]."""
        return np.searchsorted(self.views, np.arange(len(self.stamps) + 1))

    def of_view(self, index: int) -> slice:
        """Return which points were chosen in a view."""
        return slice(int(self.bounds[index]), int(self.bounds[index + 1]))


class SkinPose(NamedTuple):
    """Where a head is that was compared with a map.

    Attributes:
        pose: between what its feature points tell and where its skin lies.
        share: how far it is the skin's, 0 to 1.
        unmatched: share of the skin looked for that was not found; all of it where no view looks alike.
    """

    pose: HeadPose
    share: float
    unmatched: float


@in_one_thread()
def make_map(views: Sequence[SkinView], shape: FloatArray, camera: Camera) -> SkinMap | None:
    """Return the map of views whose poses are those of one person's points; None of too few.

    Args:
        views: in the order of their time.
        shape: (K, 3) the person's neutral face, mm.
        camera: that took them.
    """
    if len(views) < LEAST_VIEWS:
        return None
    begun = _with_points(views, shape, camera)
    if not len(begun.points):
        return None
    told, surface = begun.poses, begun.points
    focal, found = np.array([camera.fx, camera.fy]), begun
    for _ in range(ROUNDS):
        observed = _observe(found, views, camera)
        poses, points = adjust_skin(observed, told, surface, focal, STEPS)
        poses, points = _in_prior_frame(*_at_prior_distance(poses, points, told), told)
        found = replace(found, points=points, poses=poses)
    return replace(found, share=_share(told.difference(found.poses)))


def _at_prior_distance(poses: HeadPose, points: FloatArray, told: HeadPose) -> tuple[HeadPose, FloatArray]:
    """Return poses and points so many times as large that heads are as far away as they were told to be.

    A head twice as large and as far away looks the same, so skin says nothing of it.
    """
    away = [np.linalg.norm(each.position, axis=1) for each in (told, poses)]
    far, nearer = np.maximum(away, 1.0)  # mm; a file may say that a head is at the camera
    factor = float(np.exp(np.median(np.log(far / nearer))))
    return HeadPose(factor * poses.position, poses.quaternion), factor * points


def _in_prior_frame(poses: HeadPose, points: FloatArray, told: HeadPose) -> tuple[HeadPose, FloatArray]:
    """Return poses and points in the head's frame that the feature points tell, on average over the views.

    With C the mean of R'^T R, of told rotations R' and the skin's R, and d the median of C R^T (t - t'):
    R C^T and t - R C^T d, and C X + d. No point is seen elsewhere; where the head's frame sits in the head
    is a convention that skin says nothing of, and begun with rough depths all heads looked up by .7 degrees.
    """
    between = multiply(conjugate(told.quaternion), poses.quaternion)
    turn = mean_quaternion(between, np.ones(len(between)))
    turned = multiply(poses.quaternion, conjugate(turn))
    shift = np.median(rotate(conjugate(turned), poses.position - told.position), axis=0)
    return HeadPose(poses.position - rotate(turned, shift), canonical(turned)), rotate(turn, points) + shift


def _with_points(views: Sequence[SkinView], shape: FloatArray, camera: Camera) -> SkinMap:
    """The map with its points on the surface, and the poses as the feature points tell them."""
    surface, owners, places, points = surface_of(shape), [], [], []
    for index, one in enumerate(views):
        pixels = pixels_wherever(camera, one.view.pose.points(surface.points))
        there = to_crop(one.placement, pixels)
        chosen = surface.corners(one.crop, there, POINTS, DISTANCE_MM * PX_PER_MM)
        owners += [index] * len(chosen)
        places.append(there[chosen])
        points.append(surface.points[chosen])
    return SkinMap(
        np.array([one.view.stamp_ns for one in views]),
        np.stack([one.crop for one in views]),
        HeadPose.stacked([one.view.pose for one in views]),
        views=np.array(owners, dtype=np.int64),
        places=np.concatenate(places),
        points=np.concatenate(points),
        share=0.0,
    )


def _observe(found: SkinMap, views: Sequence[SkinView], camera: Camera) -> Observations:
    """Find the points of all views in those that are near in time or turned alike."""
    in_views, of_points, pixels = [], [], []
    for index, one in enumerate(views):
        own = found.of_view(index)
        matches = [(np.arange(own.start, own.stop), found.places[own])]
        away = np.abs(found.stamps - found.stamps[index]).astype(np.float64)
        away[index] = np.inf
        pose = found.poses.of_frame(index)
        for other in views_for(pose.quaternion, away, found.poses.quaternion, LINKED, LINKED):
            matches.append(_matched(found, other, one.crop, one.placement, pose, camera))
        for which, places in matches:
            in_views.append(np.full(len(which), index))
            of_points.append(which)
            pixels.append(to_image(one.placement, places))
    rays = normalised_from_pixels(camera, np.concatenate(pixels))
    return observations(np.concatenate(in_views), np.concatenate(of_points), rays, len(found.points))


def _matched(
    found: SkinMap, view: int, crop: ImageArray, placement: FloatArray, pose: HeadPose, camera: Camera
) -> tuple[IntArray, FloatArray]:
    """Return which points of a view are found in a crop, and where in it."""
    which = found.of_view(view)
    if which.start == which.stop:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    expected = to_crop(placement, pixels_wherever(camera, pose.points(found.points[which])))
    places, there = track_points(found.crops[view], found.places[which], crop, expected)
    return which.start + np.flatnonzero(there), places[there]


def _share(apart: FloatArray) -> float:
    """How far the skin is believed: d^2 / (d^2 + s^2), d how far the two poses of views (n, 6) are apart.

    Both err; the skin by about s, ``ERROR_DEG``, on all faces, the feature points the more the more d is.
    """
    turns = apart[:, 3:] - np.median(apart[:, 3:], axis=0)
    squared = float(np.mean(np.sum(np.degrees(turns) ** 2, axis=1)))
    return squared / (squared + ERROR_DEG**2)


@in_one_thread()
def pose_on_map(found: SkinMap, image: ImageArray, stamp_ns: int, told: HeadPose, camera: Camera) -> SkinPose:
    """Return the pose of a head, between what its feature points tell and where its skin lies on a map.

    Args:
        found: the map.
        image: grey, of the frame.
        stamp_ns: of the frame.
        told: pose by feature points.
        camera: that took it.
    """
    placement = place_crop(camera, told)
    crop, away = cut(image, placement), np.abs(found.stamps - stamp_ns).astype(np.float64)
    chosen = views_for(told.quaternion, away, found.poses.quaternion, NEAR, ALIKE)
    matches = [_matched(found, view, crop, placement, told, camera) for view in chosen]
    count = sum(len(which) for which, _ in matches)
    looked_for = sum(len(found.places[found.of_view(view)]) for view in chosen)
    unmatched = 1.0 - count / max(looked_for, 1)
    if count <= LEAST_POINTS:
        return SkinPose(told, 0.0, unmatched)
    which = np.concatenate([one for one, _ in matches])
    pixels = to_image(placement, np.concatenate([places for _, places in matches]))
    rays, focal = normalised_from_pixels(camera, pixels), np.array([camera.fx, camera.fy])
    pose = adjust_pose(rays, found.points[which], told, told, focal, POSE_STEPS)
    sure = min((count - LEAST_POINTS) / (ENOUGH_POINTS - LEAST_POINTS), 1.0)
    share = found.share * sure
    return SkinPose(told.moved(share * told.difference(pose)), share, unmatched)


def cut_view(image: ImageArray, camera: Camera, view: PointView) -> SkinView:
    """Return what is kept of a frame whose points were found."""
    placement = place_crop(camera, view.pose)
    return SkinView(view, cut(image, placement), placement)
