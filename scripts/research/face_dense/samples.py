"""Training samples: crops at inaccurate poses, with the places of the points in them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import pixels_wherever
from posetrack_cli.head.dense.points import LEFT_LIDS, MOUTH_POINTS, RIGHT_LIDS
from posetrack_cli.head.dense.regions import (
    LEFT_EYE,
    MOUTH_REGION,
    RIGHT_EYE,
    Region,
    crop,
    image_from_crop,
    mapped,
)
from posetrack_cli.head.face.points import HeadPose
from research.face_dense.mesh import FaceKit
from research.face_dense.people import Face, random_face, random_identity
from research.face_dense.scenes import BALL_MM, Scene, degraded, random_scene
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
        gazes: (N, 2) rad, to the side of the crop's columns and up; zeros for the mouth.
        people: (N,) index of the person.
    """

    crops: ImageArray
    targets: FloatArray
    gazes: FloatArray
    people: FloatArray


def joined(parts: Sequence[Samples]) -> Samples:
    """Return the samples of several parts."""
    return Samples(
        *(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Samples))
    )


def draw_samples(kit: FaceKit, people: int, seed: int) -> dict[str, Samples]:
    """Draw faces of random people; return samples of the mouth and of the eyes."""
    found: dict[str, list[tuple[ImageArray, FloatArray, FloatArray, int]]] = {"mouth": [], "eye": []}
    painter = SkinPainter(kit)
    for person in range(people):
        rng = np.random.default_rng([seed, person])
        identity = random_identity(kit, rng)
        skin = painter.paint(rng)
        brows = kit.on_skin(skin.brows)
        for _ in range(FACES_PER_PERSON):
            face = random_face(kit, identity, rng)
            scene = random_scene(kit, face, skin.texture, rng)
            for _ in range(VARIANTS):
                for region, sample in _samples_of(scene, face, brows.of(face.vertices), rng):
                    found[region].append((*sample, person))
    return {
        name: Samples(
            np.array([one[0] for one in rows]),
            np.array([one[1] for one in rows], np.float32),
            np.array([one[2] for one in rows], np.float32),
            np.array([one[3] for one in rows]),
        )
        for name, rows in found.items()
    }


def _samples_of(
    scene: Scene, face: Face, brows: FloatArray, rng: np.random.Generator
) -> Iterator[tuple[str, tuple[ImageArray, FloatArray, FloatArray]]]:
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
        at = mapped(np.asarray(np.linalg.inv(homography), np.float64), seen)
        target = np.column_stack([at, points[:, 2] - region.centre_mm[2]])
        yield region.name.split("_")[-1], (crop(image, homography, region), target, _gaze(region, face))


def _gaze(region: Region, face: Face) -> FloatArray:
    if region is MOUTH_REGION:
        return np.zeros(2)
    gaze = face.gazes[1 if region.mirrored else 0]
    side = np.arctan2(gaze[0], gaze[2]) * (-1.0 if region.mirrored else 1.0)
    return np.array([side, np.arcsin(gaze[1])])


def _inaccurate(pose: HeadPose, rng: np.random.Generator) -> HeadPose:
    """Return a pose with errors of a tracker, and of the place of the head's frame in a person."""
    worse = 2.0 if rng.random() < 0.1 else 1.0
    turn = np.radians([2.0, 1.7, 0.8]) * rng.standard_normal(3) * worse
    shift = np.array([1.5, 1.5, 0.0]) * rng.standard_normal(3) * worse
    moved = pose.moved(np.concatenate([shift, turn]))
    return replace(moved, position=moved.position * np.exp(rng.normal(0.0, 0.04)))
