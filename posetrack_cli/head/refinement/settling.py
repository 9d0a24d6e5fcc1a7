"""The first shape's depths, from what the cameras see of each point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import RefinementSettings
from posetrack_cli.head.pose import HeadPose
from posetrack_cli.head.refinement.recalculation import recalculate_points
from posetrack_cli.head.refinement.refine import make_prior
from posetrack_cli.head.refinement.scene import make_scene
from posetrack_cli.head.templates import take_templates

ROUNDS, STEPS = 3, 5
"""A point that came nearer or went away is looked at from there again."""


def settle(
    images: Sequence[ImageArray | None],
    cameras: Sequence[Camera],
    pose: HeadPose,
    shape: FloatArray,
    settings: RefinementSettings,
) -> FloatArray:
    """Return the shape (K, 3), mm, at which the patches of all cameras agree best **[ours]**.

    A point of a shape that was just found may lie some mm before or behind the skin that its patches show:
    then the reference templates of two cameras ask for one depth and the comparison between the cameras
    for another, and every later pose is pulled to and fro. Here the first camera with an image holds the
    point at its pixel, and the comparison between the cameras moves it along the ray.

    Args:
        images: grey, uint8, one a camera; None where a camera gave none.
        cameras: of the recording.
        pose: of the head.
        shape: (K, 3) as found, mm.
        settings: weights, steps.
    """
    prior = make_prior(np.full(len(shape), settings.settling_mm), settings)
    points = np.array(shape, dtype=np.float64)
    for _ in range(ROUNDS):
        templates = take_templates(images, cameras, pose, points)
        held = replace(templates, seen=_first_camera_only(templates.seen))
        scene, _seen = make_scene(images, cameras, [held], None, pose, points, settings)
        correlations = np.empty(templates.seen.shape)
        pixels = np.empty((*templates.seen.shape, 2))
        most = STEPS
        recalculate_points(
            scene, pose.rotation, pose.position, shape, prior, most, points, correlations, pixels
        )
    return points


def _first_camera_only(seen: BoolArray) -> BoolArray:
    """Return (C, K) where the first camera that sees anything sees a point."""
    first: BoolArray = np.zeros_like(seen)
    camera = int(np.argmax(seen.any(axis=1)))
    first[camera] = seen[camera]
    return first
