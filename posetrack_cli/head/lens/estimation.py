"""Estimation of the focal length of an uncalibrated camera before a run **[ours]**.

Some frames of the recording are tracked with a likely focal length. Prior (``prior``) and the skin's evidence
(``profile``) then give the posterior.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.adjustment.adjuster import angles_of
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.initialisation.mono import eye_distance_px
from posetrack_cli.head.lens.lens import EstimatedLens
from posetrack_cli.head.lens.prior import centre_prior, is_crop, log_focal_lengths, log_prior
from posetrack_cli.head.lens.profile import Change, log_likelihoods
from posetrack_cli.head.skin.map import MatchedSkin
from posetrack_cli.head.tracker.head_tracker import HeadTracker
from posetrack_cli.head.tracker.mono import MonoPeople
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results.estimate import Status
from posetrack_cli.tracking.options import RunOptions

FIRST_FOCAL = 1.6
"""Focal length over the longer image side with which the frames are tracked: 35 degrees."""
FRAMES, STRETCHES = 150, 5
"""Number of frames tracked; of longer recordings, in this number of stretches."""
MOST_LOST = 60
"""Lost frames after which no more are looked at; searching for a face is slow."""
EVALUATIONS = 13
"""Number of values of log f, and of each coordinate of the principal point, at which the skin is adjusted."""
FLOOR_SD = 0.05
"""Least standard deviation of log f: faces move while they turn."""


class FirstLook(NamedTuple):
    """What a few frames show.

    Attributes:
        camera: with which they were tracked.
        poses: of tracked frames.
        skin: matched skin of the face, and its camera; None with too few views.
        stated: focal length over the longer image side in the metadata of the files.
    """

    camera: Camera
    poses: list[HeadPose]
    skin: tuple[MatchedSkin, Camera] | None
    stated: float | None = None

    @property
    def longer_px(self) -> int:
        """Longer image side."""
        return max(self.camera.width, self.camera.height)

    @property
    def log_focal(self) -> float:
        """u of the camera."""
        return math.log(self.camera.fx / self.longer_px)


def estimate_lens(
    recording: Recording, options: RunOptions, make_people: Callable[[Camera], MonoPeople]
) -> EstimatedLens:
    """Estimate the focal length of a recording's only camera, which has no calibration."""
    (camera,) = recording.cameras
    first_focal = FIRST_FOCAL * max(camera.width, camera.height)
    camera = replace(camera, fx=first_focal, fy=first_focal)
    return posterior(_first_look(recording, options, camera, make_people(camera)))


def posterior(seen: FirstLook) -> EstimatedLens:
    """Return the camera with means and standard deviations given some frames.

    The focal length and the coordinates of the principal point are estimated one after the other, then the
    focal length again.
    """
    camera, u, centre = seen.camera, log_focal_lengths(), np.zeros(2)
    prior = log_prior(u, _eye_distance(seen) / seen.longer_px, is_crop=is_crop(camera), stated=seen.stated)
    focal = _moments(u, prior + _of_focal_lengths(seen, u, centre))
    places, of_places = centre_prior(camera, focal.mean)
    sds = np.zeros(2)
    for axis in range(2):
        log_density = of_places + _of_coordinates(seen, focal.mean, centre, axis, places / camera.fx)
        centre[axis], sds[axis] = np.array(_moments(places, log_density)) / camera.fx
    focal = _moments(u, prior + _of_focal_lengths(seen, u, centre))
    f, (cx, cy) = seen.longer_px * math.exp(focal.mean), camera.fx * centre
    f, cx, cy = (round(value, 1) for value in (f, camera.cx + cx, camera.cy + cy))
    found = replace(camera, fx=f, fy=f, cx=cx, cy=cy)
    sd = math.hypot(focal.sd, FLOOR_SD)
    return EstimatedLens(found, sd, camera.fx * sds, *_usual(seen, found))


class Moments(NamedTuple):
    """Mean and standard deviation."""

    mean: float
    sd: float


def _moments(values: FloatArray, log_density: FloatArray) -> Moments:
    weights = np.exp(log_density - log_density.max())
    weights /= weights.sum()
    mean = float(weights @ values)
    return Moments(mean, math.sqrt(float(weights @ np.square(values - mean))))


def _of_focal_lengths(seen: FirstLook, u: FloatArray, centre: FloatArray) -> FloatArray:
    """Return the log-likelihood of values of u."""
    return _interpolated(seen, u, lambda value: Change(value - seen.log_focal, centre))


def _of_coordinates(
    seen: FirstLook, u: float, centre: FloatArray, axis: int, coordinates: FloatArray
) -> FloatArray:
    """Return the log-likelihood of values of one coordinate of the principal point."""
    along, others = np.eye(2)[axis], centre * (1.0 - np.eye(2)[axis])
    return _interpolated(seen, coordinates, lambda value: Change(u - seen.log_focal, others + value * along))


def _interpolated(seen: FirstLook, values: FloatArray, change: Callable[[float], Change]) -> FloatArray:
    """Return the skin's log-likelihood of values, from ``EVALUATIONS`` of them; zeros without skin."""
    if seen.skin is None:
        return np.zeros_like(values)
    from scipy.interpolate import CubicSpline  # imported late, as it takes time

    some = np.linspace(values[0], values[-1], EVALUATIONS)
    found: FloatArray = CubicSpline(some, log_likelihoods(*seen.skin, [change(one) for one in some]))(values)
    return found


def _eye_distance(seen: FirstLook) -> float:
    """Return the usual eye distance of the face, pixels; NaN without a face."""
    distances = [eye_distance_px(pose, seen.camera) for pose in seen.poses]
    return float(np.median(distances)) if distances else math.nan


def _usual(seen: FirstLook, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return the usual ray of the head, x/z and y/z, and its usual yaw and pitch, rad."""
    if not seen.poses:
        return np.zeros(2), np.zeros(2)
    first, poses = seen.camera, HeadPose.stacked(seen.poses)
    ray = np.median(poses.position[:, :2] / poses.position[:, 2:], axis=0)
    pixels = ray * first.fx + [first.cx, first.cy]
    angles: FloatArray = np.median(angles_of(poses.rotation[:, :, 2]), axis=0)
    return (pixels - [camera.cx, camera.cy]) / camera.fx, angles


def _first_look(recording: Recording, options: RunOptions, camera: Camera, people: MonoPeople) -> FirstLook:
    """Track some frames."""
    tracker = HeadTracker(people)
    rng, state, poses, lost = np.random.default_rng(0), None, [], 0
    for frame in _some_frames(recording, options):
        if state is None:
            state = tracker.start(frame, rng)
        state, estimate = tracker.step(state, frame, rng)
        if estimate.status is not Status.LOST:
            poses.append(HeadPose(estimate.position, estimate.quaternion))
            continue
        lost += 1
        if lost >= MOST_LOST:
            break
    skin = None if state is None else people.matched_skin(state)
    return FirstLook(camera, poses, skin, recording.stated_focal)


def _some_frames(recording: Recording, options: RunOptions) -> Iterator[Frame]:
    """Yield the frames to look at: all of a short recording, stretches of a long one."""
    start, stride, count = options.start, options.stride, recording.frame_count
    end = start + FRAMES * stride if count is None else count
    end = end if options.end is None else min(end, options.end)
    every = np.arange(start, end, stride)
    if len(every) > FRAMES:
        length = FRAMES // STRETCHES
        begins = np.linspace(0, len(every) - length, STRETCHES).astype(int)
        every = every[(begins[:, None] + np.arange(length)).ravel()]
    yield from recording.pick(every.tolist())
