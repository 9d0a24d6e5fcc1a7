"""Training samples: crops at inaccurate poses, with the places of the points in them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera, pixels_wherever
from posetrack_cli.head.dense.points import LEFT_LIDS, MOUTH_POINTS, RIGHT_LIDS
from posetrack_cli.head.dense.regions import (
    LEFT_EYE,
    MOUTH_REGION,
    RIGHT_EYE,
    crop,
    gaze_region,
    image_from_crop,
)
from posetrack_cli.head.face.points import HeadPose
from research.face_dense.mesh import FaceKit
from research.face_dense.people import BALL_MM, Face, random_face, random_identity, random_pupils
from research.face_dense.scenes import Scene, degraded, random_scene
from research.face_dense.skin import SkinPainter

VARIANTS = 2
"""Images of other quality, and poses with other errors, of each drawn scene."""
FACES_PER_PERSON = 12


@dataclass(frozen=True, eq=False)
class Samples:
    """Crops and targets of one kind of region.

    Attributes:
        crops: (N, height, width) uint8.
        targets: (N, P, 3) crop pixels, and mm in front of the region's plane.
        people: (N,) index of the person.
    """

    crops: ImageArray
    targets: FloatArray
    people: FloatArray


def joined(parts: Sequence[Samples]) -> Samples:
    """Return the samples of several parts."""
    return Samples(
        *(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Samples))
    )


def draw_samples(kit: FaceKit, people: int, seed: int) -> dict[str, Samples]:
    """Draw faces of random people; return samples of the mouth and of the eyes."""
    found: dict[str, list[tuple[ImageArray, FloatArray, int]]] = {"mouth": [], "eye": []}
    painter = SkinPainter(kit)
    for person in range(people):
        rng = np.random.default_rng([seed, person])
        identity, pupils_mm = random_identity(kit, rng), random_pupils(rng)
        skin = painter.paint(rng)
        brows = kit.on_skin(skin.brows)
        for _ in range(FACES_PER_PERSON):
            face = random_face(kit, identity, pupils_mm, rng)
            scene = random_scene(kit, face, skin.texture, rng)
            for _ in range(VARIANTS):
                for region, sample in _samples_of(scene, face, brows.of(face.vertices), rng):
                    found[region].append((*sample, person))
    return {
        name: Samples(
            np.array([one[0] for one in rows]),
            np.array([one[1] for one in rows], np.float32),
            np.array([one[2] for one in rows]),
        )
        for name, rows in found.items()
    }


def _samples_of(
    scene: Scene, face: Face, brows: FloatArray, rng: np.random.Generator
) -> Iterator[tuple[str, tuple[ImageArray, FloatArray]]]:
    image, camera = _recorded(scene, rng)
    pose = _inaccurate(scene.pose, rng)
    irises = face.eyes + BALL_MM * face.gazes
    for region, points in (
        (MOUTH_REGION, face.landmarks[list(MOUTH_POINTS)]),
        (RIGHT_EYE, np.vstack([brows[:5], face.landmarks[list(RIGHT_LIDS)], irises[0]])),
        (LEFT_EYE, np.vstack([brows[5:], face.landmarks[list(LEFT_LIDS)], irises[1]])),
    ):
        homography = image_from_crop(region, pose, camera)
        assert homography is not None
        seen = pixels_wherever(camera, scene.pose.points(points))
        at = cv2.perspectiveTransform(seen[None], np.linalg.inv(homography))[0]
        target = np.column_stack([at, points[:, 2] - region.centre_mm[2]])
        yield region.name.split("_")[-1], (crop(image, homography, region), target)


def _recorded(scene: Scene, rng: np.random.Generator) -> tuple[ImageArray, Camera]:
    """Return a scene's image of random quality, and its camera."""
    image, scale = degraded(scene.image, rng)
    height, width = image.shape
    old = scene.camera
    camera = replace(
        old,
        width=width,
        height=height,
        fx=old.fx * scale,
        fy=old.fy * scale,
        cx=(old.cx + 0.5) * scale - 0.5,
        cy=(old.cy + 0.5) * scale - 0.5,
    )
    return image, camera


class GazeSample(NamedTuple):
    """Crop (height, width) uint8 of an eye, and its gaze (2,) rad, to the side of the columns and up."""

    crop: ImageArray
    gaze: FloatArray


CORNERS = ((36, 39), (42, 45))
LEAST_OPENING_MM = 3.0
"""Lids of a person whose gaze is learned."""


def kit_gazes(kit: FaceKit, people: int, seed: int) -> list[GazeSample]:
    """Draw faces of random people with open eyes; return samples of their eyes."""
    painter, found = SkinPainter(kit), []
    for person in range(people):
        rng = np.random.default_rng([seed, person])
        identity, pupils_mm = random_identity(kit, rng), random_pupils(rng)
        skin = painter.paint(rng)
        for _ in range(FACES_PER_PERSON):
            face = random_face(kit, identity, pupils_mm, rng)
            opening = np.linalg.norm(
                face.landmarks[[37, 38, 43, 44]] - face.landmarks[[41, 40, 47, 46]], axis=1
            )
            if opening.min() < LEAST_OPENING_MM:
                continue
            scene = random_scene(kit, face, skin.texture, rng)
            corners = face.landmarks[list(CORNERS)]
            for _ in range(VARIANTS):
                image, camera = _recorded(scene, rng)
                found += gaze_samples(image, camera, scene.pose, corners, face.gazes, rng)
    return found


CORNER_SD_MM = 0.7
"""Errors of located eye corners."""


def gaze_samples(
    image: ImageArray,
    camera: Camera,
    pose: HeadPose,
    corners: FloatArray,
    gazes: FloatArray,
    rng: np.random.Generator,
) -> list[GazeSample]:
    """Return a sample of each eye, at an inaccurate pose.

    The gaze is in the axes of that pose, as no crop shows its error.

    Args:
        image, camera, pose: of the face.
        corners: (2, 2, 3) mm, of the right and left eye.
        gazes: (2, 3) unit vectors in the head's axes.
        rng: draws errors.
    """
    inaccurate = _inaccurate(pose, rng)
    found = []
    for side, (own, gaze) in enumerate(zip(corners, gazes, strict=True)):
        seen = pose.points(own.mean(axis=0))
        # what the errors of the pose and of the corners leave: the middle's place in the image
        ray = seen / seen[2] * inaccurate.position[2]
        middle = inaccurate.rotation.T @ (ray - inaccurate.position)
        middle = middle + CORNER_SD_MM * rng.standard_normal(3) * (1.0, 1.0, 2.0)
        region = gaze_region(middle, mirrored=side == 1)
        homography = image_from_crop(region, inaccurate, camera)
        assert homography is not None
        x, y, z = inaccurate.rotation.T @ (pose.rotation @ gaze)
        to_side = np.arctan2(x, z) * (-1.0 if region.mirrored else 1.0)
        found.append(GazeSample(crop(image, homography, region), np.array([to_side, np.arcsin(y)])))
    return found


def _inaccurate(pose: HeadPose, rng: np.random.Generator) -> HeadPose:
    """Return a pose with errors of a tracker, and of the place of the head's frame in a person."""
    worse = 2.0 if rng.random() < 0.1 else 1.0
    turn = np.radians([2.0, 1.7, 0.8]) * rng.standard_normal(3) * worse
    shift = np.array([1.5, 1.5, 0.0]) * rng.standard_normal(3) * worse
    moved = pose.moved(np.concatenate([shift, turn]))
    return replace(moved, position=moved.position * np.exp(rng.normal(0.0, 0.04)))
