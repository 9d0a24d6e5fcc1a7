"""Hands of people as vectors: template registered to the skin, and bones, in units of hand length."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.model.anatomy import (
    BONE_COUNT,
    HandAnatomy,
    HandShape,
    reshaped_anatomy,
    reshaped_skin,
)
from posetrack_cli.hand.model.webxr import PER_METRE, FileHand, joint_places, straightened
from posetrack_cli.hand.shape_fit import MEASURES, measures_of
from posetrack_cli.rendering.gltf import read_glb, read_skin
from posetrack_cli.rendering.mesh import SkinnedMesh, smoothing
from research.hand_model.registration import Skin, Template
from research.hand_model.template import SEGMENTS, THUMB_BASE, adult, cage_of, with_wrist

# (16,) standard deviations of the logarithms of shape factors: additional variation, to cover people and
# rigs outside the training set
FURTHER_SD: FloatArray = np.array([0.0, *[0.03] * 5, *[0.05] * 5, 0.035, 0.025, 0.05, 0.06, 0.03])
# Length from the wrist to the tip of the middle finger in the rigs, mean of women and men; the registered
# skin ends 2 mm before
RIG_LENGTH_MM = 181.0
_MEAN_OF, _SEED = 120, 5
_WRIST_MM = 4.0


def rows(files: Sequence[Path]) -> Iterator[FloatArray]:
    """Yield a flattened ``population.RestHand`` (D,) for each file."""
    surface = smoothing(cage_of(adult()).triangles, 1)
    template = Template(surface.triangles, surface.through)
    weights = np.asarray(surface.blend @ cage_of(adult()).weights)
    mean = _mean_hand([person_hand(path, None) for path in files[:_MEAN_OF]])
    start = surface.through @ cage_of(mean.anatomy).vertices
    laid = template.laid_coarsely(start, Skin(mean.skin), _WRIST_MM)
    reference = SkinnedMesh(laid, weights, surface.triangles)
    rng = np.random.default_rng(_SEED)
    for path in files:
        hand = _reshaped(person_hand(path, rng), rng)
        vertices = reference.posed(_stretches(mean.anatomy, hand.anatomy)[None])[0]
        cage = template.cage(template.laid(vertices, Skin(hand.skin)))
        a, size = hand.anatomy, RIG_LENGTH_MM / _length(hand.anatomy)
        parts = (with_wrist(size * cage), *(size * one for one in (a.base_positions, a.segments, a.radii)))
        yield np.concatenate([part.ravel() for part in parts])


def person_hand(path: Path, rng: np.random.Generator | None) -> FileHand:
    """Return a person's hand at zero angles, with sampled joint positions."""
    skin = read_skin(read_glb(path))
    places, joints = joint_places(skin, path), skin.joint_positions.copy()
    joints[places] = anatomical_joints(PER_METRE * joints[places], rng) / PER_METRE
    return straightened(replace(skin, joint_positions=joints), path, adult())


def _mean_hand(hands: Sequence[FileHand]) -> FileHand:
    """Return the mean of hands with the same triangles, in units of hand length."""
    sizes = [RIG_LENGTH_MM / _length(hand.anatomy) for hand in hands]

    def mean(parts: Sequence[FloatArray]) -> FloatArray:
        return np.asarray(np.mean([size * part for size, part in zip(sizes, parts, strict=True)], axis=0))

    skin = replace(hands[0].skin, vertices=mean([hand.skin.vertices for hand in hands]))
    bones = [hand.anatomy for hand in hands]
    anatomy = replace(
        adult(),
        base_positions=mean([one.base_positions for one in bones]),
        segments=mean([one.segments for one in bones]),
        radii=mean([one.radii for one in bones]),
    )
    return FileHand(anatomy, skin)


def _reshaped(hand: FileHand, rng: np.random.Generator) -> FileHand:
    """Return the hand with random shape factors."""
    shape = HandShape.of_factors(np.exp(rng.normal(0.0, FURTHER_SD)))
    skin = reshaped_skin(hand.skin, hand.anatomy, "right", shape)
    return FileHand(replace(reshaped_anatomy(hand.anatomy, "right", shape), palm=(1.0, 1.0, 1.0)), skin)


def _stretches(start: HandAnatomy, end: HandAnatomy) -> FloatArray:
    """Return affine maps (16, 3, 4) from the bones of one hand to those of another, including girths."""
    maps = np.zeros((BONE_COUNT, 3, 4))
    knuckles, others = start.base_positions[1:], end.base_positions[1:]
    wide = np.ptp(others[:, 0]) / np.ptp(knuckles[:, 0])
    long = np.linalg.norm(others, axis=1).mean() / np.linalg.norm(knuckles, axis=1).mean()
    thick = float(np.median(end.radii[1:, 0] / start.radii[1:, 0]))
    maps[0, :, :3] = np.diag([wide, long, 0.5 * (long + thick)])
    for finger, frame in enumerate(start.base_rotations):
        girth = float(np.median(end.radii[finger] / start.radii[finger]))
        for bone in range(3):
            length = end.segments[finger, bone] / start.segments[finger, bone]
            stretch = frame @ np.diag([girth, length, girth]) @ frame.T
            at = maps[1 + 3 * finger + bone]
            at[:, :3] = stretch
            at[:, 3] = end.rest_origins[finger, bone] - stretch @ start.rest_origins[finger, bone]
    return maps


def _length(anatomy: HandAnatomy) -> float:
    """Return the length from the wrist to the tip of the straight middle finger, mm."""
    return float(measures_of(anatomy)[MEASURES.index("hand_length")])


# Joint positions lie between those of the rig and those of anatomy.
#
# Rigs place joints where the mesh deforms well; they differ by 5 to 20 mm at wrist, knuckles and thumb.
# Anatomy: first phalanx at least 1.6 times as long as the second, finger segments by Buryanov and Kotiuk
# 2010, thumb base at the trapezium.

# Mean and standard deviation of the joint position between rig (0) and anatomy (1)
ANATOMY_SHARE = (1.0, 0.5)
# Further standard deviations of joints 3, 2 and 1, mm: along the finger, and out of the palm plane
ALONG_SD, BESIDE_SD = np.array([2.0, 1.2, 1.2]), np.array([2.0, 0.8, 0.8])
THUMB_BASE_SD, WRIST_SD = (3.0, 2.0, 3.0), (3.0, 2.0, 2.0)  # mm: along the palm, out of its plane, across it
_KNUCKLE = 1.6  # ratio of first to second phalanx, for rigs that bend at the webs
_PALM_MM = 90.0  # wrist to middle knuckle of the hand that ``THUMB_BASE`` refers to


def anatomical_joints(joints: FloatArray, rng: np.random.Generator | None) -> FloatArray:
    """Return sampled joint positions (21, 3) in a hand, mm; without a generator, the mean positions.

    Tips are unchanged: rigs have them at the end of the skin within 1 to 2 mm. The build moves them to the
    end of the registered skin.
    """
    up, out, side = _palm_axes(joints)
    mean, sd = ANATOMY_SHARE
    share = mean + (sd * rng.normal() if rng else 0.0)
    result = joints.copy()
    axes = np.stack([up, out, side])
    if rng:
        result[0] += rng.normal(0.0, WRIST_SD) @ axes
    for finger in range(5):
        chain = joints[1 + 4 * finger : 5 + 4 * finger]
        ours = _thumb(chain, joints, axes) if finger == 0 else _finger(chain, finger)
        placed = chain[:3] + share * (ours - chain[:3])
        if rng:
            for k in range(3):
                placed[k] += rng.normal(0.0, ALONG_SD[k]) * _unit(chain[k + 1] - chain[k])
                placed[k] += rng.normal(0.0, BESIDE_SD[k]) * out
            if finger == 0:
                placed[0] += rng.normal(0.0, THUMB_BASE_SD) @ axes
        result[1 + 4 * finger : 4 + 4 * finger] = placed
    return result


def _palm_axes(joints: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return unit vectors towards the fingers, out of the palm of a right hand, and towards the thumb."""
    up = _unit(joints[9] - joints[0])
    out = np.cross(joints[5] - joints[0], joints[17] - joints[0])
    out = _unit(out - up * (out @ up))
    side = np.cross(out, up)
    return up, out, side * np.sign(side @ (joints[5] - joints[17]))


def _finger(chain: FloatArray, finger: int) -> FloatArray:
    """Return joints 3, 2, 1 of a finger (3, 3): knuckle moved back, the rest divided by the tables."""
    first, second = np.linalg.norm(np.diff(chain[:3], axis=0), axis=1)
    knuckle = chain[0] + max(_KNUCKLE * second - first, 0.0) * (chain[0] - chain[1]) / first
    whole = np.vstack([knuckle, chain[1:]])
    length = float(np.linalg.norm(np.diff(whole, axis=0), axis=1).sum())
    shares = np.cumsum(SEGMENTS[finger])[:2] / SEGMENTS[finger].sum()
    return np.vstack([knuckle, _along(whole, shares * length)])


def _thumb(chain: FloatArray, joints: FloatArray, axes: FloatArray) -> FloatArray:
    """Return joints 3, 2, 1 of the thumb (3, 3): base at the trapezium, the rest divided by the tables."""
    size = float(np.linalg.norm(joints[9] - joints[0])) / _PALM_MM
    x, y, z = THUMB_BASE * size
    base = joints[0] + np.array([-y, -z, x]) @ axes
    outer = chain[1:]
    length = float(np.linalg.norm(np.diff(outer, axis=0), axis=1).sum())
    share = SEGMENTS[0, 1] / SEGMENTS[0, 1:].sum()
    return np.vstack([base, chain[1], _along(outer, np.array([share * length]))])


def _along(points: FloatArray, distances: FloatArray) -> FloatArray:
    """Return points at given distances from the start of a chain (N, 3)."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    k = np.clip(np.searchsorted(starts, distances, side="right") - 1, 0, len(lengths) - 1)
    share = (distances - starts[k]) / lengths[k]
    return np.asarray(points[k] + share[:, None] * (points[k + 1] - points[k]))


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v))
