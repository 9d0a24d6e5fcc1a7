"""The dense face of each frame: points, actions, blinks and gaze, added to a head tracker's estimates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera, pixels_wherever
from posetrack_cli.head.actions import ACTION_NAMES
from posetrack_cli.head.dense.expressions import strengths
from posetrack_cli.head.dense.lengths import (
    GAP,
    LENGTH_NAMES,
    LENGTHS,
    LIDS,
    UNKNOWN_PERSON,
    WIDTH,
    Lengths,
    Person,
    lengths_of,
)
from posetrack_cli.head.dense.measure import DensePoints, average_face, measure, together
from posetrack_cli.head.dense.network import shipped_networks
from posetrack_cli.head.dense.numbers import FACE_NUMBERS
from posetrack_cli.head.dense.points import DENSE_COUNT, OUTER_LIPS, rows
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.face.rig_images import RigImages
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.columns import floats
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.tracking.confidence import PROBABLY
from posetrack_cli.tracking.state_codec import Codec, Fields, Stacked, codec_of, flag

DECIMALS = 3
"""Digits after the point of coordinates in results, which keeps the files small."""
CLOSED_SHARE = 0.15
"""Opening of a closed eye, as a share of the open one."""
SHUT_BELOW, OPEN_ABOVE = 0.4, 0.55
"""Lid openings at which eyes count as closed and as open again."""
LARGEST_LID_SD = 0.5
"""Standard deviation of both eyes' opening, as a share, up to which it determines blinks."""
EYE_DISTANCE_MM, LEAST_EYES_PX = 63.0, 40.0
"""Usual distance of the eyes, and their distance in the reference image from which the gaze is stated."""
AT_REST_MM = np.array([1.5, 2.0, 3.0, 1.5, 1.5, 1.5, 1.5, 2.5, 2.5])
"""(L,) mm, difference of lengths from rest up to which a face counts as neutral."""
_LIPS = rows(*OUTER_LIPS)
CLOSED_LIPS_MM = LENGTHS[GAP].usual_mm
LIP_ERROR_MM = (-1.5, 1.5)
"""Limits of a person's constant error of the lip gap."""
UNLIKE_MM = (3.0, 3.5)
"""Mean standard deviation of the lips' points, seen from the front: up to the first, a mouth is seen;
from the second on something else, such as a face mask. Turned faces have larger ones."""
RIGHT_UNLIKE, UNLIKE_SD = 0.55, np.radians([12.0, 5.0, 1.0])
"""Probability that a pose is right whose mouth is something else, and the standard deviations of its pitch,
yaw and roll: the points there are taken for those of a face."""
PRIOR_FACES = 10.0
"""Number of frames that the average face counts for in a person's neutral face."""
LEARNED_EVERY = 3
"""Interval, in frames, at which a first of two passes measures the face, to learn what is usual."""


@dataclass(frozen=True, eq=False)
class NeutralFace:
    """Neutral face of a person.

    Attributes:
        total: (D, 3) mm, weighted sum of places.
        weight: (D,) sum of the weights.
    """

    total: Annotated[FloatArray, floats(DENSE_COUNT, 3)]
    weight: Annotated[FloatArray, floats(DENSE_COUNT, least=0.0)]

    @property
    def places(self) -> FloatArray:
        """(D, 3) mm in the head's frame."""
        return self.total / self.weight[:, None]

    def after(self, places: FloatArray, weight: float) -> NeutralFace:
        """Return the face after a frame with points (D, 3); NaN points are unknown."""
        known = ~np.isnan(places[:, :1])
        added = np.where(known, weight, 0.0)
        return NeutralFace(self.total + added * np.where(known, places, 0.0), self.weight + added[:, 0])


@dataclass(frozen=True, eq=False)
class KnownFace:
    """What is known of one person's face.

    Attributes:
        lengths: usual lengths.
        neutral: neutral face.
        is_closed: whether the eyes are closed.
    """

    lengths: Person
    neutral: NeutralFace
    is_closed: bool = False


KNOWN_FACES: Codec[tuple[KnownFace, ...]] = Stacked(
    Fields(
        KnownFace, lengths=codec_of(Person), neutral=codec_of(NeutralFace), is_closed=("is_closed", flag())
    ),
    "people",
)
"""Codec of what is known of each person."""


class DenseFaces:
    """Measures the dense face at tracked poses, and learns what is usual for each person.

    Args:
        cameras: of the recording, the reference first.
        number_names: names of the tracker's own numbers. The dense face replaces its actions.
        every: interval of the frames that are measured, each of which counts for as many.
    """

    def __init__(self, cameras: Sequence[Camera], number_names: Sequence[str], every: int = 1) -> None:
        self.every = every
        self._cameras = tuple(cameras)
        self._kept = [index for index, name in enumerate(number_names) if name not in ACTION_NAMES]
        self._networks = shipped_networks()
        average = average_face(self._networks)
        neutral = NeutralFace(PRIOR_FACES * average, np.full(DENSE_COUNT, PRIOR_FACES))
        self._unknown = KnownFace(UNKNOWN_PERSON, neutral)

    def add(
        self, known: tuple[KnownFace, ...], frame: Frame, estimate: Estimate, person: int
    ) -> tuple[tuple[KnownFace, ...], Estimate]:
        """Return what is known after a frame, and its estimate with points and numbers of the dense face.

        Args:
            known: what is known of each person so far.
            frame: recorded images.
            estimate: with the pose.
            person: index of the person.
        """
        known = (*known, *[self._unknown] * (person + 1 - len(known)))
        face, pose = known[person], HeadPose(estimate.position, estimate.quaternion)
        own = np.zeros(0) if estimate.numbers is None else estimate.numbers[self._kept]
        if estimate.confidence <= 0.0:  # no head
            nothing = np.full(len(FACE_NUMBERS), np.nan)
            return known, replace(estimate, numbers=np.concatenate([own, nothing]))
        points = measure(self._networks, RigImages(self._cameras, frame.images), pose)
        lengths = lengths_of(points.places, points.covariances)
        face = _after(face, lengths, points, self.every)
        known = (*known[:person], face, *known[person + 1 :])
        camera = self._cameras[0]
        eyes_px = EYE_DISTANCE_MM * np.sqrt(camera.fx * camera.fy) / estimate.position[2]
        if eyes_px >= LEAST_EYES_PX:
            estimate = doubted(estimate, points)
        gazes = points.gazes if eyes_px >= LEAST_EYES_PX else np.full((2, 3), np.nan)
        numbers = [own, _actions(face, lengths, points), _gazes(face, lengths, gazes, pose)]
        numbers.append(_dense(points, pose, camera))
        return known, replace(estimate, numbers=np.concatenate(numbers))


def doubted(estimate: Estimate, points: DensePoints) -> Estimate:
    """Return an estimate with the confidence and the variances that a mouth leaves that looks like none."""
    pose = HeadPose(estimate.position, estimate.quaternion)
    facing = float(-pose.rotation[:, 2] @ pose.position / np.linalg.norm(pose.position))
    low, high = np.array(UNLIKE_MM) / max(facing, 0.1) ** 2
    sd = float(np.sqrt(points.variances[_LIPS]).mean())
    unlike = float(np.clip((sd - low) / (high - low), 0.0, 1.0)) if np.isfinite(sd) else 0.0
    confidence = estimate.confidence * (1.0 - unlike * (1.0 - RIGHT_UNLIKE))
    if estimate.confidence >= PROBABLY:  # the status stays
        confidence = max(confidence, PROBABLY)
    variance = estimate.pose_variance
    if variance is not None:
        variance = variance + np.pad(np.square(unlike * UNLIKE_SD), (3, len(variance) - 6))
    return replace(estimate, confidence=confidence, pose_variance=variance)


def _openings(person: Person, lengths: Lengths) -> tuple[FloatArray, FloatArray]:
    """Return the openings of the lids (2,) as shares of the open eye, and their standard deviations."""
    wide, wide_sd = person.rest[LIDS], person.rest_sd[LIDS]
    ratio = lengths.values[LIDS] / wide
    sd = np.hypot(lengths.deviations[LIDS], ratio * wide_sd) / wide
    scale = 1.0 / (1.0 - CLOSED_SHARE)
    return np.maximum(scale * (ratio - CLOSED_SHARE), 0.0), scale * sd


def _mean_opening(person: Person, lengths: Lengths) -> float:
    """Return the opening of both eyes; NaN if it is too uncertain to tell open from closed."""
    shares, sd = _openings(person, lengths)
    known = ~np.isnan(shares)
    precisions = sd[known] ** -2
    if precisions.sum() < LARGEST_LID_SD**-2:
        return np.nan
    return float(precisions @ shares[known] / precisions.sum())


def _after(face: KnownFace, lengths: Lengths, points: DensePoints, count: int) -> KnownFace:
    """Return what is known of a face after a frame that stands for ``count``."""
    person = face.lengths.after(lengths, count)
    opening, is_closed = _mean_opening(person, lengths), face.is_closed
    if not np.isnan(opening):
        is_closed = opening < (OPEN_ABOVE if is_closed else SHUT_BELOW)
    away = np.nan_to_num(np.abs(lengths.values - person.rest) / AT_REST_MM)
    weight = count * float(np.exp(-0.5 * np.square(away).max()))
    return KnownFace(person, face.neutral.after(points.places, weight), is_closed)


def _actions(face: KnownFace, lengths: Lengths, points: DensePoints) -> FloatArray:
    """Return the numbers of actions, their standard deviations, and whether the eyes are closed."""
    person = face.lengths
    as_they_are = np.isin(np.arange(len(LENGTH_NAMES)), [GAP, WIDTH, *LIDS])
    values = np.where(as_they_are, lengths.values, lengths.values - person.rest)
    # closed lips have a known gap, so a constant error shows in the usual lips
    values[GAP] = max(values[GAP] - np.clip(person.rest[GAP] - CLOSED_LIPS_MM, *LIP_ERROR_MM), 0.0)
    sd = np.where(as_they_are, lengths.deviations, np.hypot(lengths.deviations, person.rest_sd))
    shares, share_sd = _openings(person, lengths)
    found, found_sd = strengths(points.places - face.neutral.places, points.variances)
    closed = np.nan if np.isnan(_mean_opening(person, lengths)) else float(face.is_closed)
    return np.concatenate([values, shares, found, sd, share_sd, found_sd, [closed]])


def _gazes(face: KnownFace, lengths: Lengths, gazes: FloatArray, pose: HeadPose) -> FloatArray:
    """Return the numbers of both eyes' gazes (2, 3): angles, deviation, direction in camera axes."""
    # False for unknown lids
    is_open = (_openings(face.lengths, lengths)[0] >= SHUT_BELOW) & (not face.is_closed)
    gazes = together(np.where(is_open[:, None], gazes, np.nan))
    side, up = gazes[:, 0], gazes[:, 1]
    in_head = np.stack([np.sin(side) * np.cos(up), np.sin(up), np.cos(side) * np.cos(up)], axis=1)
    numbers: FloatArray = np.hstack([gazes, in_head @ pose.rotation.T]).ravel()
    return numbers


def _dense(points: DensePoints, pose: HeadPose, camera: Camera) -> FloatArray:
    """Return the numbers of the points, in space and in the image of the reference camera."""
    seen = pose.points(points.places)
    sd = np.sqrt(points.variances)
    focal = np.sqrt(camera.fx * camera.fy)
    pixels, sd_px = pixels_wherever(camera, seen), sd * focal / seen[:, 2]
    numbers: FloatArray = np.column_stack([points.places, sd, pixels, sd_px]).ravel()
    return np.round(numbers, DECIMALS)
