"""Training samples of gazes on drawn people, as ``head synth`` draws them."""

from __future__ import annotations

import numpy as np

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.face.points import EYES, HeadPose
from posetrack_cli.rendering.devices import device_or_default
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.synthesis.head.eyes import OpenEye
from posetrack_cli.synthesis.head.frames import Plan, Scene, Sensor, make_plan
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.person import EXPRESSIONS
from research.face_dense.people import random_gazes
from research.face_dense.samples import GazeSample, gaze_samples
from research.face_dense.scenes import random_angles

FIRST_IDENTITY = 100_000
"""Identities from here on are for training only."""
SIZE = (480, 360)
EYE_DISTANCE_MM = 63.0
EYES_PX = (36.0, 130.0)
FRAMES_PER_PERSON = 40


def draw_gazes(people: int, seed: int) -> list[GazeSample]:
    """Draw people that look around from random directions; return samples of their eyes."""
    found: list[GazeSample] = []
    with device_or_default(None) as device:
        for person in range(people):
            rng = np.random.default_rng([seed, person])
            identity = FIRST_IDENTITY + 1000 * seed + person
            options = HeadSynthOptions(
                cameras=1, identity=identity, frames=FRAMES_PER_PERSON, fps=1.0, seed=identity
            )
            found += _of_person(make_plan(options), device, rng)
    return found


def _of_person(plan: Plan, device: RenderingDevice, rng: np.random.Generator) -> list[GazeSample]:
    rest = HeadPose(plan.movement.origin, plan.movement.rest)
    scene = Scene(device, plan.person, plan.identity.looks, plan.grid, SIZE, rest, plan.scenery)
    strengths = plan.script.strengths(plan.timeline.seconds)
    found: list[GazeSample] = []
    try:
        for index, seconds in enumerate(plan.timeline.seconds.tolist()):
            gazes = random_gazes(rng)
            closing = float(rng.uniform(0.0, 0.5)) if rng.random() < 0.3 else 0.0
            eyes = tuple(OpenEye(gaze, closing) for gaze in gazes)
            focal = 600.0
            distance = EYE_DISTANCE_MM * focal / np.exp(rng.uniform(*np.log(EYES_PX)))
            camera = Camera(*SIZE, focal, focal, SIZE[0] / 2 - 0.5, SIZE[1] / 2 - 0.5)
            pose = HeadPose(
                np.array([0.0, 0.0, distance]), head_quaternion_from_roll_pitch_yaw(random_angles(rng))
            )
            now = strengths[index].copy()
            now[EXPRESSIONS.index("blink")] = 0.0
            scene.set(pose, now, eyes, None)
            sensor = Sensor(camera, float(rng.uniform(0.2, 2.0)))
            image = sensor.image(scene.renderer.image(camera, plan.illumination.at(seconds)), rng)
            corners = plan.person.points[EYES]  # right outer, inner, left inner, outer
            found += gaze_samples(image, camera, pose, corners.reshape(2, 2, 3), gazes, rng)
    finally:
        scene.release()
    return found
