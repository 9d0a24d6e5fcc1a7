"""Map of a person's skin, built in a first pass, and poses relative to it.

The ten feature points of a real face slide, which causes yaw errors of a few degrees. Some hundred corners of
the skin are matched between frames over the whole recording, and their positions are adjusted together with
the poses. A frame's pose then follows from its skin points. Skin is more accurate on real faces, feature
points on rendered ones; ``share`` is the weight of the skin. With several cameras, skin is matched between
their images as well.
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
from posetrack_cli.head.skin.equations import (
    MEASURED_SD,
    POSE_SD,
    Observations,
    SkinPrior,
    adjust_pose,
    adjust_skin,
    in_cameras,
    observations,
)
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
"""Minimum number of views; a map of fewer adds nothing to a single frame."""
POINTS, DISTANCE_MM = 40, 9.0
"""Maximum number of skin corners per view, and their minimum spacing."""
LINKED = 6
"""Number of views near in time, and with similar pose, in which points are matched."""
ROUNDS, STEPS = 2, 8
"""Rounds of matching and adjustment, and steps of each."""
NEAR, ALIKE = 2, 1
"""Number of views near in time, and with similar pose, that a frame is compared with."""
ERROR_DEG, MEASURED_ERROR_DEG = 1.5, 0.7
"""Typical error of poses from skin with one camera and with several; determines their weight."""
LEAST_POINTS, ENOUGH_POINTS = 15, 60
"""Number of matched points below which the skin has no weight, and above which it has its full weight."""
POSE_STEPS = 5


@dataclass(frozen=True, eq=False)
class SkinMap:
    """Views of the skin, and points in them.

    Attributes:
        stamps: (n,) of the views, ns.
        crops: (n, C, HEIGHT, WIDTH), of each camera.
        poses: (n) adjusted.
        images: (M,) image in which each point was chosen, C view + camera, in ascending order.
        places: (M, 2) its place in that crop.
        points: (M, 3) adjusted, mm in the head's frame.
        share: 0 to 1, weight of a pose from skin relative to that from feature points.
    """

    stamps: IntArray
    crops: ImageArray
    poses: HeadPose
    images: IntArray
    places: FloatArray
    points: FloatArray
    share: float

    @property
    def cameras(self) -> int:
        """C, number of cameras."""
        return int(self.crops.shape[1])

    @cached_property
    def bounds(self) -> IntArray:
        """(n C + 1,) points of image i are those from bounds[i] up to bounds[i + 1]."""
        return np.searchsorted(self.images, np.arange(self.cameras * len(self.stamps) + 1))

    def of_image(self, index: int) -> slice:
        """Return the points chosen in an image."""
        return slice(int(self.bounds[index]), int(self.bounds[index + 1]))

    def crop(self, index: int) -> ImageArray:
        """Return the crop of an image."""
        crop: ImageArray = self.crops[divmod(index, self.cameras)]
        return crop


class SkinPose(NamedTuple):
    """Pose of a head compared with a map.

    Attributes:
        pose: between those of feature points and skin.
        share: weight of the skin, 0 to 1.
        unmatched: share of the skin points that were not found; 1 without a similar view.
    """

    pose: HeadPose
    share: float
    unmatched: float


class MatchedSkin(NamedTuple):
    """A map with the data it was adjusted to.

    Attributes:
        map: adjusted, with a share of 0.
        observed: matched places in the views.
        prior: poses of the feature points, and initial surface.
    """

    map: SkinMap
    observed: Observations
    prior: SkinPrior


@in_one_thread()
def match_skin(views: Sequence[SkinView], shape: FloatArray, cameras: Sequence[Camera]) -> MatchedSkin | None:
    """Match the skin of views with the poses of one person's points; None if there are too few.

    Args:
        views: in the order of time.
        shape: (K, 3) the person's neutral face, mm.
        cameras: of the views, the reference first.
    """
    if len(views) < LEAST_VIEWS:
        return None
    found = _with_points(views, shape, cameras)
    if not len(found.points):
        return None
    prior = SkinPrior(found.poses, found.points, _pose_sd(cameras))
    for _ in range(ROUNDS):
        # better poses predict the places of points better, so matching is repeated
        observed = _observe(found, views, cameras)
        poses, points = adjust_skin(observed, prior, _focal(cameras), STEPS, None, _transforms(cameras))
        poses, points = _in_prior_frame(*_at_prior_distance(poses, points, prior.poses), prior.poses)
        found = replace(found, points=points, poses=poses)
    return MatchedSkin(found, observed, prior)


def make_map(views: Sequence[SkinView], shape: FloatArray, cameras: Sequence[Camera]) -> SkinMap | None:
    """Build a map from views; see ``match_skin``."""
    matched = match_skin(views, shape, cameras)
    if matched is None:
        return None
    error_deg = ERROR_DEG if len(cameras) == 1 else MEASURED_ERROR_DEG
    return replace(matched.map, share=_share(matched.prior.poses.difference(matched.map.poses), error_deg))


def _transforms(cameras: Sequence[Camera]) -> FloatArray:
    return np.array([camera.camera_T_reference for camera in cameras])


def _focal(cameras: Sequence[Camera]) -> FloatArray:
    return np.array([cameras[0].fx, cameras[0].fy])


def _pose_sd(cameras: Sequence[Camera]) -> FloatArray:
    return POSE_SD if len(cameras) == 1 else MEASURED_SD


def _at_prior_distance(
    poses: HeadPose, points: FloatArray, by_points: HeadPose
) -> tuple[HeadPose, FloatArray]:
    """Scale poses and points so that the median distance of the head equals the prior's.

    A head of twice the size at twice the distance looks the same, so skin does not determine the scale.
    """
    away = [np.linalg.norm(each.position, axis=1) for each in (by_points, poses)]
    far, nearer = np.maximum(away, 1.0)  # mm; a damaged file may place a head at the camera
    factor = float(np.exp(np.median(np.log(far / nearer))))
    return HeadPose(factor * poses.position, poses.quaternion), factor * points


def _in_prior_frame(poses: HeadPose, points: FloatArray, by_points: HeadPose) -> tuple[HeadPose, FloatArray]:
    """Express poses and points in the head's frame of the feature points, averaged over the views.

    With C the mean of R'^T R, of prior rotations R' and the skin's R, and d the median of C R^T (t - t'):
    R C^T and t - R C^T d, and C X + d. The projections do not change. The placement of the head's frame is a
    convention that skin does not determine; rough initial depths would otherwise bias the pitch.
    """
    between = multiply(conjugate(by_points.quaternion), poses.quaternion)
    turn = mean_quaternion(between, np.ones(len(between)))
    turned = multiply(poses.quaternion, conjugate(turn))
    shift = np.median(rotate(conjugate(turned), poses.position - by_points.position), axis=0)
    return HeadPose(poses.position - rotate(turned, shift), canonical(turned)), rotate(turn, points) + shift


def _with_points(views: Sequence[SkinView], shape: FloatArray, cameras: Sequence[Camera]) -> SkinMap:
    """Return the map with initial points on the surface and the poses of the feature points."""
    surface, owners, places, points = surface_of(shape), [], [], []
    poses = HeadPose.stacked([one.view.pose for one in views])
    own = in_cameras(poses, _transforms(cameras))
    for index, (crop, placement) in enumerate(_images(views)):
        pixels = pixels_wherever(cameras[index % len(cameras)], own.of_frame(index).points(surface.points))
        there = to_crop(placement, pixels)
        chosen = surface.corners(crop, there, POINTS, DISTANCE_MM * PX_PER_MM)
        owners += [index] * len(chosen)
        places.append(there[chosen])
        points.append(surface.points[chosen])
    return SkinMap(
        np.array([one.view.stamp_ns for one in views]),
        np.stack([one.crops for one in views]),
        poses,
        images=np.array(owners, dtype=np.int64),
        places=np.concatenate(places),
        points=np.concatenate(points),
        share=0.0,
    )


def _images(views: Sequence[SkinView]) -> list[tuple[ImageArray, FloatArray]]:
    """Return crop and placement of each image."""
    return [pair for one in views for pair in zip(one.crops, one.placements, strict=True)]


def _observe(found: SkinMap, views: Sequence[SkinView], cameras: Sequence[Camera]) -> Observations:
    """Match the points of all images in others that are near in time or have a similar pose."""
    in_views, of_points, rays = [], [], []
    own, stamps = in_cameras(found.poses, _transforms(cameras)), np.repeat(found.stamps, len(cameras))
    for index, (crop, placement) in enumerate(_images(views)):
        chosen, camera = found.of_image(index), cameras[index % len(cameras)]
        matches = [(np.arange(chosen.start, chosen.stop), found.places[chosen])]
        away = np.abs(stamps - stamps[index]).astype(np.float64)
        away[index] = np.inf
        pose = own.of_frame(index)
        for other in views_for(pose.quaternion, away, own.quaternion, LINKED, LINKED):
            matches.append(_matched(found, other, crop, placement, pose, camera))
        for which, places in matches:
            in_views.append(np.full(len(which), index))
            of_points.append(which)
            rays.append(normalised_from_pixels(camera, to_image(placement, places)))
    owners = np.concatenate(of_points)
    return observations(np.concatenate(in_views), owners, np.concatenate(rays), len(found.points))


def _matched(
    found: SkinMap, image: int, crop: ImageArray, placement: FloatArray, pose: HeadPose, camera: Camera
) -> tuple[IntArray, FloatArray]:
    """Return the points of an image found in a crop, and their places in it; the pose in camera axes."""
    which = found.of_image(image)
    if which.start == which.stop:
        return _NO_MATCH
    expected = to_crop(placement, pixels_wherever(camera, pose.points(found.points[which])))
    places, there = track_points(found.crop(image), found.places[which], crop, expected)
    return which.start + np.flatnonzero(there), places[there]


def _share(apart: FloatArray, error_deg: float) -> float:
    """Return the weight of the skin, d^2 / (d^2 + s^2), d the RMS of pose differences (n, 6).

    Both have errors; that of the skin is about s, ``error_deg``, so a larger d is due to the feature points.
    """
    # a constant rotation between the two is a matter of convention, not an error
    turns = apart[:, 3:] - np.median(apart[:, 3:], axis=0)
    squared = float(np.mean(np.sum(np.degrees(turns) ** 2, axis=1)))
    return squared / (squared + error_deg**2)


@in_one_thread()
def pose_on_map(
    found: SkinMap,
    images: Sequence[ImageArray | None],
    stamp_ns: int,
    by_points: HeadPose,
    cameras: Sequence[Camera],
) -> SkinPose:
    """Return the pose of a head between those of its feature points and of its skin on a map.

    Args:
        found: the map.
        images: grey, of the frame.
        stamp_ns: of the frame.
        by_points: pose from feature points.
        cameras: of the images, the reference first.
    """
    transforms = _transforms(cameras)
    own = in_cameras(HeadPose.stacked([by_points]), transforms)
    known = in_cameras(found.poses, transforms).quaternion
    away = np.repeat(np.abs(found.stamps - stamp_ns).astype(np.float64), len(cameras))
    seen, count, looked_for = [], 0, 0
    for index, (camera, image) in enumerate(zip(cameras, images, strict=True)):
        matches, pose = [_NO_MATCH], own.of_frame(index)
        placement = place_crop(camera, pose)
        if image is not None:
            crop = cut(image, placement)
            chosen = views_for(pose.quaternion, away, known, NEAR, ALIKE)
            matches += [_matched(found, one, crop, placement, pose, camera) for one in chosen]
            looked_for += sum(len(found.places[found.of_image(one)]) for one in chosen)
        which = np.concatenate([one for one, _ in matches])
        pixels = to_image(placement, np.concatenate([places for _, places in matches]))
        seen.append((normalised_from_pixels(camera, pixels), found.points[which]))
        count += len(which)
    unmatched = 1.0 - count / max(looked_for, 1)
    if count <= LEAST_POINTS:
        return SkinPose(by_points, 0.0, unmatched)
    f, pose_sd = _focal(cameras), _pose_sd(cameras)
    pose = adjust_pose(seen, by_points, by_points, f, POSE_STEPS, transforms, pose_sd)
    sure = min((count - LEAST_POINTS) / (ENOUGH_POINTS - LEAST_POINTS), 1.0)
    share = found.share * sure
    return SkinPose(by_points.moved(share * by_points.difference(pose)), share, unmatched)


_NO_MATCH = (np.zeros(0, dtype=np.int64), np.zeros((0, 2)))


def cut_view(images: Sequence[ImageArray], cameras: Sequence[Camera], view: PointView) -> SkinView:
    """Return the skin view of a frame with located points."""
    own = in_cameras(HeadPose.stacked([view.pose]), _transforms(cameras))
    placements = [place_crop(camera, own.of_frame(index)) for index, camera in enumerate(cameras)]
    crops = [cut(image, placement) for image, placement in zip(images, placements, strict=True)]
    return SkinView(view, np.stack(crops), np.stack(placements))
