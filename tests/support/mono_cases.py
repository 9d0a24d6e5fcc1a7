"""Arrays and states of the one-camera tracker at random, and what it means that two are the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass

import numpy as np

from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.adjustment.adjuster import Album, PersonParameters, PointView
from posetrack_cli.head.face.points import POINT_COUNT, HeadPose
from posetrack_cli.head.face.templates import WINDOW, TemplateSet
from posetrack_cli.head.initialisation.mono import DetectedFace
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.particles.filter import HeadParticles
from posetrack_cli.head.skin.map import SkinMap
from posetrack_cli.head.skin.matching import HEIGHT, WIDTH, SkinAlbum, SkinView
from posetrack_cli.head.tracker.frame_tracker import TrackState
from posetrack_cli.head.tracker.person import IdentityHistory, KnownPerson, Size, person_shape


def assert_same(first: object, second: object, where: str = "it") -> None:
    """Equal in every field, bit for bit; NaN is equal to NaN."""
    assert type(first) is type(second) or (isinstance(first, float) and isinstance(second, float)), where
    if is_dataclass(first):
        for one in fields(first):
            assert_same(getattr(first, one.name), getattr(second, one.name), f"{where}.{one.name}")
    elif isinstance(first, np.ndarray):
        assert first.dtype == second.dtype, where
        np.testing.assert_array_equal(first, second, err_msg=where)
    elif isinstance(first, Mapping):
        assert first.keys() == second.keys(), where
        for key in first:
            assert_same(first[key], second[key], f"{where}[{key!r}]")
    elif isinstance(first, (tuple, list)):
        assert len(first) == len(second), where
        for index, (one, other) in enumerate(zip(first, second, strict=True)):
            assert_same(one, other, f"{where}[{index}]")
    else:
        assert first == second or (first != first and second != second), where


def random_pose(rng: np.random.Generator) -> HeadPose:
    """Any direction within half a radian."""
    angles = rng.uniform(-0.5, 0.5, 3)
    return HeadPose(
        np.array([0.0, 0.0, 700.0]) + rng.normal(size=3), head_quaternion_from_roll_pitch_yaw(angles)
    )


def random_templates(seed: int) -> TemplateSet:
    """Of one camera."""
    rng, count = np.random.default_rng(seed), (1, POINT_COUNT)
    return TemplateSet(
        rng.integers(0, 256, (*count, WINDOW, WINDOW), dtype=np.uint8),
        rng.uniform(20.0, 28.0, (*count, 2)),
        rng.normal(size=(*count, 2, 2)),
        rng.random(count) < 0.8,
        random_pose(rng).facing,
    )


def random_view(rng: np.random.Generator, stamp_ns: int, model: FaceModel) -> PointView:
    """A frame; one of its points was not seen."""
    pixels = rng.uniform(0.0, 480.0, (POINT_COUNT, 2))
    pixels[rng.integers(POINT_COUNT)] = np.nan
    weights = rng.random(POINT_COUNT)
    return PointView(stamp_ns, pixels, weights, random_pose(rng), rng.normal(size=model.deformation_size))


def random_known(seed: int, model: FaceModel, views: int = 3, sets: int = 2) -> KnownPerson:
    """A person who was adjusted from some frames."""
    rng, album = np.random.default_rng(seed), Album()
    person = PersonParameters(rng.normal(size=model.identity_size), rng.normal(size=(POINT_COUNT, 3)))
    history = IdentityHistory(rng.normal(size=(4, model.identity_size)), 6)
    frames = tuple(random_view(rng, 10**18 + index, model) for index in range(views))
    for view in frames:
        album = album.with_view(view, rng.random())
    templates = tuple(random_templates(seed + index) for index in range(sets))
    size = Size(1.0 + 0.2 * rng.random(), 0.1 * rng.random()) if seed % 2 else None
    shape = person_shape(model, person, size)
    usual = rng.random()
    return KnownPerson(
        person, history, frames, album, shape, templates, views, usual, is_held=seed % 2 > 0, size=size
    )


def random_skin(seed: int, model: FaceModel, views: int = 2) -> SkinAlbum:
    """Frames that show the skin."""
    rng, shown = np.random.default_rng(seed), []
    for index in range(views):
        crop = rng.integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
        a, b = rng.normal(size=2)
        placement = np.column_stack([[[a, -b], [b, a]], rng.uniform(0.0, 400.0, 2)])
        shown.append(SkinView(random_view(rng, 10**18 + index, model), crop[None], placement[None]))
    return SkinAlbum(tuple(shown), 250_000_000 * 2 ** (seed % 3))


def random_map(seed: int, views: int = 3, points: int = 7) -> SkinMap:
    """A map; some view may have no points."""
    rng = np.random.default_rng(seed)
    poses = [random_pose(rng) for _ in range(views)]
    return SkinMap(
        10**18 + np.arange(views),
        rng.integers(0, 256, (views, 1, HEIGHT, WIDTH), dtype=np.uint8),
        HeadPose.stacked(poses),
        np.sort(rng.integers(0, views, points)),
        rng.uniform(0.0, WIDTH, (points, 2)),
        rng.normal(size=(points, 3)),
        rng.random(),
    )


def random_detected(seed: int, stamp_ns: int) -> DetectedFace:
    """A face that was found in one frame."""
    rng = np.random.default_rng(seed)
    pixels, responses = rng.uniform(0.0, 480.0, (POINT_COUNT, 2)), rng.random(POINT_COUNT)
    score, distance, misfit = (float(value) for value in rng.random(3))
    return DetectedFace(stamp_ns, pixels, responses, score, distance, random_pose(rng), misfit)


def random_track(seed: int, model: FaceModel, seen: bool = True) -> TrackState:
    """A head that is tracked."""
    rng, size = np.random.default_rng(seed), model.deformation_size
    weights = rng.random(20)
    particles = HeadParticles(
        random_pose(rng),
        rng.normal(size=size),
        rng.normal(size=(20, 6 + size)),
        weights / weights.sum(),
        model.of_person(rng.normal(size=model.identity_size)),
    )
    shape = rng.normal(size=(POINT_COUNT, 3))
    templates = random_templates(seed) if seen else None
    return TrackState(10**18 + seed, random_pose(rng), rng.normal(size=6), particles, shape, templates)
