"""Images of faces: camera, light, skin, eyes, mouth, glasses, hair, hands, and the camera's faults."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray, IntArray
from posetrack_cli.geometry.camera import Camera, pixels_wherever
from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.face.points import HeadPose
from research.face_dense.drawing import rasterise, vertex_normals
from research.face_dense.mesh import EYEBALLS, GUMS, SKIN, TEETH, FaceKit
from research.face_dense.people import BALL_MM, Face

WIDTH, HEIGHT = 310, 340
PX_PER_MM = 1.5
"""Resolution of drawn faces."""
EYE_DISTANCE_MM = 63.0
IRIS_MM = 5.9
Mask: TypeAlias = np.ndarray[Any, np.dtype[Any]]
"""Share (HEIGHT, WIDTH) of a covering thing in each pixel."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Image of a face (HEIGHT, WIDTH), 0 to 1, with the camera and the head's pose."""

    image: FloatArray
    camera: Camera
    pose: HeadPose


def random_scene(kit: FaceKit, face: Face, skin: ImageArray, rng: np.random.Generator) -> Scene:
    """Draw a face with a skin from a random direction in random light."""
    distance = np.exp(rng.uniform(np.log(300.0), np.log(1800.0)))
    focal = PX_PER_MM * distance
    camera = Camera(WIDTH, HEIGHT, focal, focal, WIDTH / 2 - 0.5, 0.37 * HEIGHT)
    quaternion = head_quaternion_from_roll_pitch_yaw(random_angles(rng))
    pose = HeadPose(np.array([0.0, 0.0, distance]), quaternion)
    points = pose.points(face.vertices)
    values = np.hstack([face.vertices, vertex_normals(points, kit.triangles)])
    drawn, kinds = rasterise(
        pixels_wherever(camera, points),
        points[:, 2],
        values,
        kit.triangles,
        kit.corners,
        kit.kinds,
        (HEIGHT, WIDTH),
    )
    image = _lit(drawn, kinds, face, skin, pose, rng)
    image = np.where(kinds >= 0, image, _background(rng))
    for add, chance in ((_glasses, 0.25), (_fringe, 0.2), (_hand, 0.08), (_shadow, 0.3)):
        if rng.random() < chance:
            image = add(image, camera, pose, rng)
    return Scene(np.clip(image, 0.0, 1.0), camera, pose)


def random_angles(rng: np.random.Generator) -> FloatArray:
    """Return roll, pitch and yaw (3,) of a head, rad."""
    angles = np.radians(
        [rng.normal(0.0, 8.0), rng.normal(0.0, 11.0), rng.choice([12.0, 30.0]) * rng.normal(0.0, 1.0)]
    )
    return np.clip(angles, np.radians([-25.0, -35.0, -55.0]), np.radians([25.0, 35.0, 55.0]))


def _lit(
    drawn: FloatArray, kinds: IntArray, face: Face, skin: ImageArray, pose: HeadPose, rng: np.random.Generator
) -> FloatArray:
    place, normal, texture = drawn[..., :3], drawn[..., 3:6], drawn[..., 6:].astype(np.float32)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)
    across, down = (np.ascontiguousarray(texture[..., axis] * skin.shape[0]) for axis in (0, 1))
    albedo = cv2.remap(skin, across, down, cv2.INTER_LINEAR).astype(np.float64) / 255.0
    shine = np.full(kinds.shape, rng.uniform(0.0, 0.25) if rng.random() < 0.6 else 0.0)
    albedo[kinds == TEETH] = rng.uniform(0.45, 0.95)
    albedo[kinds == GUMS] = rng.uniform(0.15, 0.5)
    albedo[(kinds > SKIN) & (kinds < GUMS)] = np.median(albedo[kinds == SKIN])
    # the mouth gets darker inwards
    inside = (kinds == TEETH) | (kinds == GUMS)
    lip = face.landmarks[[62, 66], 2].mean()
    throat = (
        (kinds == SKIN) & (np.abs(texture[..., 0] - 0.5) < 0.06) & (np.abs(texture[..., 1] - 0.568) < 0.035)
    )
    fall_mm = rng.uniform(5.0, 25.0)
    depth = np.maximum(lip - 4.0 - place[..., 2], 0.0)
    albedo = np.where(inside | throat, albedo * rng.uniform(0.4, 1.0) * np.exp(-depth / fall_mm), albedo)
    eye = kinds == EYEBALLS
    if eye.any():
        albedo[eye] = _eyes(place[eye], face, rng)
        covered = cv2.GaussianBlur(eye.astype(np.float64), (0, 0), rng.uniform(1.0, 3.0))
        albedo[eye] *= (1.0 - rng.uniform(0.2, 0.8) * (1.0 - covered))[eye]
        shine[eye] = rng.uniform(0.2, 1.0)
    light, glint = np.full(kinds.shape, rng.uniform(0.15, 0.9)), np.zeros(kinds.shape)
    light += 0.5 * normal @ rng.normal(0.0, 0.25, 3)
    for _ in range(rng.integers(1, 4)):
        source = rng.normal(0.0, 1.0, 3) * (1.0, 1.0, 0.5) + (0.0, -0.4, -1.0)
        source /= np.linalg.norm(source)
        strength = rng.uniform(0.0, 0.9)
        facing = normal @ source
        light += strength * np.clip(facing, 0.0, None)
        half = source - np.array([0.0, 0.0, 1.0])
        half /= np.linalg.norm(half)
        sharp = np.where(eye, 200.0, rng.uniform(5.0, 40.0))
        glint += strength * np.clip(normal @ half, 0.0, None) ** sharp
    image: FloatArray = albedo * light * rng.uniform(0.6, 1.2) + shine * glint
    image = image * rng.uniform(0.5, 0.95) / max(float(np.percentile(image[kinds == SKIN], 95)), 1e-3)
    return np.clip(image, 0.0, 1.0) ** rng.uniform(0.5, 1.3)


def _eyes(places: FloatArray, face: Face, rng: np.random.Generator) -> FloatArray:
    """Return the albedo at places (N, 3) on the eyeballs: sclera, iris with limbus, pupil."""
    side = (places[:, 0] > 0.0).astype(int)
    from_centre = places - face.eyes[side]
    from_centre /= np.linalg.norm(from_centre, axis=1, keepdims=True)
    cosine = np.einsum("ij,ij->i", from_centre, face.gazes[side])
    across = BALL_MM * np.arccos(np.clip(cosine, -1.0, 1.0))
    iris_mm, soft = IRIS_MM * rng.uniform(0.92, 1.08), rng.uniform(0.3, 1.2)
    pupil_mm = rng.uniform(1.2, 3.5)
    sclera, iris = rng.uniform(0.55, 1.0), rng.uniform(0.04, 0.5)
    in_iris = 1.0 / (1.0 + np.exp((across - iris_mm) / (0.25 * soft)))
    limbus = rng.uniform(0.0, 0.6) * np.exp(-np.square((across - iris_mm) / 0.8))
    in_pupil = 1.0 / (1.0 + np.exp((across - pupil_mm) / 0.15))
    ball = sclera * (1.0 - in_iris) + iris * (1.0 - limbus) * in_iris
    return np.asarray(ball * (1.0 - in_pupil) + 0.02 * in_pupil)


def _background(rng: np.random.Generator) -> FloatArray:
    coarse = rng.uniform(0.0, 1.0) + rng.normal(
        0.0, rng.uniform(0.0, 0.25), (rng.integers(1, 9), rng.integers(1, 9))
    )
    drawn = cv2.resize(np.clip(coarse, 0.0, 1.0), (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)
    return drawn.astype(np.float64)


def _over(image: FloatArray, mask: Mask, colour: float) -> FloatArray:
    return np.asarray(image * (1.0 - mask) + colour * mask)


def _drawn(camera: Camera, pose: HeadPose, places: FloatArray) -> IntArray:
    """Return places (N, 3) of the head as polygon in sixteenths of a pixel."""
    return np.round(pixels_wherever(camera, pose.points(places)) * 16).astype(np.int32)


def _glasses(image: FloatArray, camera: Camera, pose: HeadPose, rng: np.random.Generator) -> FloatArray:
    angle = np.linspace(0.0, 2.0 * np.pi, 41)
    power = rng.uniform(0.45, 1.0)
    wide, high = rng.uniform(22.0, 31.0), rng.uniform(14.0, 25.0)
    x = wide * np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** power
    y = high * np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** power
    z, drop = rng.uniform(12.0, 24.0), rng.uniform(-6.0, 3.0)
    apart = rng.uniform(30.0, 36.0)
    frame, glass = np.zeros_like(image, np.float32), np.zeros_like(image, np.float32)
    width = max(1, round(rng.uniform(0.5, 4.0) * PX_PER_MM))
    for side in (-1.0, 1.0):
        ring = np.column_stack([side * apart + x, y + drop, np.full_like(x, z) - 0.12 * np.abs(x + apart)])
        polygon = _drawn(camera, pose, ring)
        cv2.polylines(frame, [polygon], True, 1.0, width, cv2.LINE_AA, 4)
        cv2.fillPoly(glass, [polygon], 1.0, cv2.LINE_AA, 4)
        temple = np.array([[side * (apart + wide), drop + 4.0, z - 8.0], [side * 76.0, drop + 4.0, -60.0]])
        cv2.polylines(frame, [_drawn(camera, pose, temple)], False, 1.0, width, cv2.LINE_AA, 4)
    bridge = np.array(
        [[-(apart - wide), drop + 4.0, z], [0.0, drop + 7.0, z + 2.0], [apart - wide, drop + 4.0, z]]
    )
    cv2.polylines(frame, [_drawn(camera, pose, bridge)], False, 1.0, width, cv2.LINE_AA, 4)
    image = image * (1.0 - rng.uniform(0.0, 0.3) * glass)
    if rng.random() < 0.5:  # reflections
        band = np.clip(
            cv2.GaussianBlur(rng.normal(0.0, 1.0, image.shape), (0, 0), rng.uniform(4.0, 15.0)) * 12, 0, 1
        )
        image = _over(image, glass * band * rng.uniform(0.0, 0.7), rng.uniform(0.6, 1.0))
    opacity = rng.uniform(0.4, 1.0)
    return _over(
        image, frame * opacity, rng.uniform(0.0, 0.35) if rng.random() < 0.7 else rng.uniform(0.3, 1.0)
    )


def _fringe(image: FloatArray, camera: Camera, pose: HeadPose, rng: np.random.Generator) -> FloatArray:
    """Cover the forehead, sometimes also the brows, with strands of hair."""
    mask, lowest = np.zeros_like(image, np.float32), rng.uniform(12.0, 60.0)
    start, end = sorted(rng.uniform(-80.0, 80.0, 2))
    for x in rng.uniform(start, end, rng.integers(5, 150)):
        slant = rng.normal(0.0, 12.0)
        tip = np.array([x + slant, lowest + rng.exponential(12.0), 25.0 - 0.004 * (x + slant) ** 2])
        root = np.array([x, 95.0, 15.0])
        strand = _drawn(camera, pose, np.array([root, 0.5 * (root + tip) + (0.0, 0.0, 8.0), tip]))
        cv2.polylines(mask, [strand], False, 1.0, int(rng.integers(1, 5)), cv2.LINE_AA, 4)
    return _over(image, mask * rng.uniform(0.5, 1.0), rng.uniform(0.0, 0.5))


def _hand(image: FloatArray, camera: Camera, pose: HeadPose, rng: np.random.Generator) -> FloatArray:
    """Cover a part of the face with something of about one brightness."""
    middle = np.array([rng.normal(0.0, 45.0), rng.normal(-60.0, 60.0), 35.0])
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, 9))
    radius = rng.uniform(12.0, 45.0, 9)
    ring = middle + np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(9)])
    mask = np.zeros_like(image, np.float32)
    cv2.fillPoly(mask, [_drawn(camera, pose, ring)], 1.0, cv2.LINE_AA, 4)
    soft = cv2.GaussianBlur(mask, (0, 0), rng.uniform(0.5, 3.0))
    shade = cv2.GaussianBlur(rng.normal(0.0, 1.0, image.shape), (0, 0), 12.0) * rng.uniform(0.0, 3.0)
    return np.asarray(image * (1.0 - soft) + np.clip(rng.uniform(0.1, 0.9) + shade, 0.0, 1.0) * soft)


def _shadow(image: FloatArray, camera: Camera, pose: HeadPose, rng: np.random.Generator) -> FloatArray:
    """Darken one side of a line."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    angle = rng.uniform(0.0, 2.0 * np.pi)
    distance = (x - WIDTH * rng.uniform(0.2, 0.8)) * np.cos(angle) + (
        y - HEIGHT * rng.uniform(0.2, 0.8)
    ) * np.sin(angle)
    lit = 1.0 - rng.uniform(0.0, 0.7) / (1.0 + np.exp(-distance / rng.uniform(1.0, 25.0)))
    return np.asarray(image * lit)


def degraded(image: FloatArray, rng: np.random.Generator) -> tuple[ImageArray, float]:
    """Return an image as a camera of random quality records it, and its scale.

    The eyes are 20 to 150 pixels apart; small faces are as frequent as large ones.
    """
    eyes_px = np.exp(rng.uniform(np.log(28.0), np.log(160.0)))
    scale = min(1.0, eyes_px / EYE_DISTANCE_MM / PX_PER_MM)
    image = image ** np.exp(rng.normal(0.0, 0.25))
    if rng.random() < 0.5:
        image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 1.2) / scale).astype(np.float64)
    if rng.random() < 0.2:
        length = rng.uniform(1.0, 5.0) / scale
        image = _motion_blurred(image, length, rng.uniform(0.0, np.pi))
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    low, contrast = rng.uniform(0.0, 0.2), rng.uniform(0.35, 1.0)
    small = low + contrast * small + rng.normal(0.0, rng.exponential(0.012), small.shape)
    grey = np.clip(small * 255.0, 0.0, 255.0).astype(np.uint8)
    if rng.random() < 0.6:
        quality = int(rng.uniform(25.0, 98.0))
        grey = cv2.imdecode(
            cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_GRAYSCALE
        )
    return grey, scale


def _motion_blurred(image: FloatArray, length: float, angle: float) -> FloatArray:
    size = 2 * int(np.ceil(length)) + 1
    kernel = np.zeros((size, size), np.float32)
    middle, half = (size - 1) / 2, 0.5 * length
    across, down = half * np.cos(angle), half * np.sin(angle)
    start, end = (
        (round((middle + sign * across) * 16), round((middle + sign * down) * 16)) for sign in (-1, 1)
    )
    cv2.line(kernel, start, end, 1.0, 1, cv2.LINE_AA, 4)
    return cv2.filter2D(image, -1, kernel / max(float(kernel.sum()), 1e-6)).astype(np.float64)
