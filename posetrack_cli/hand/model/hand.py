"""Hand models (bones and skin), and the space of hand poses."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import UsageError
from posetrack_cli.filtering.filters import FILTERS
from posetrack_cli.filtering.model import Dynamics
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.config import ComponentSettings, FilterSettings, HandConfig, HandSettings
from posetrack_cli.hand.model.anatomy import (
    ANGLE_LIMITS,
    ANGLE_NAMES,
    ANGLES,
    POSE_SIZE,
    HandAnatomy,
    HandShape,
    make_anatomy,
    population,
    reshaped_skin,
    shape_between,
)
from posetrack_cli.hand.model.forearm import with_forearm
from posetrack_cli.hand.model.kinematics import skinning_transforms
from posetrack_cli.rendering.decimation import Decimation, decimation
from posetrack_cli.rendering.mesh import SkinnedMesh, smoothing
from posetrack_cli.results.columns import Layout
from posetrack_cli.tracking.velocity import BodySpace

# Hand models: bones and skin

LEAN_TRIANGLES = 410
_LEAN_ARM, _SMOOTH_ARM = (10, 5), (16, 7)
# flexion of joints 3 and 2, rad: open, half closed, fist, hooked, bent at the knuckles only
_BENDS = ((0.0, 0.0), (0.8, 0.9), (1.4, 1.6), (0.2, 1.3), (1.3, 0.2))
_THUMB_SHARE = 0.5  # of the fingers' bends in the thumb's


def lean_mesh(anatomy: HandAnatomy, smooth: SkinnedMesh | None = None) -> SkinnedMesh:
    """Return the skin of an average hand in any shape with ``LEAN_TRIANGLES`` triangles.

    All hands share triangles and weights; vertices are linear in those of the smooth skin.

    Args:
        anatomy: of ``make_anatomy``.
        smooth: its ``medium`` mesh, if available.
    """
    smooth = smooth or hand_mesh(anatomy, "medium")
    mesh = _average_decimation().of(smooth.vertices)
    return (
        SkinnedMesh(mesh.vertices, mesh.weights, mesh.triangles[:, ::-1].copy()) if anatomy.is_left else mesh
    )


def bent_hands(anatomy: HandAnatomy) -> FloatArray:
    """Return bone transforms (K, B, 3, 4) of open to closed hands, for fitting simplified skins."""
    poses = np.zeros((len(_BENDS), POSE_SIZE))
    poses[:, 6] = 1.0
    for pose, (first, second) in zip(poses, _BENDS, strict=True):
        for k, name in enumerate(ANGLE_NAMES):
            if name.endswith("flexion"):
                share = _THUMB_SHARE if name.startswith("thumb") else 1.0
                pose[POSE_SIZE - len(ANGLE_NAMES) + k] = share * (first if _is_first(name) else second)
    return np.asarray(skinning_transforms(anatomy, poses), dtype=np.float64)


def _is_first(name: str) -> bool:
    return "cmc" in name or ("mcp" in name and not name.startswith("thumb"))


@functools.cache
def _average_decimation() -> Decimation:
    """Return the map from smooth to lean skin, computed once for the average right hand."""
    average = make_anatomy()
    return decimation(hand_mesh(average, "medium"), LEAN_TRIANGLES, bent_hands(average))


MESH_DIGEST = "hand.mesh_sha256"
"""Key of the run record with the digest of a hand file."""
SMOOTH_TRIANGLES = 1640
"""Triangles of the smooth skin of a hand from a file, as many as the average hand's."""
_MAX_TRIANGLES = 2 * SMOOTH_TRIANGLES
"""Largest skin after simplification (of parts that cannot be joined); memory grows with its square."""

HandMaker = Callable[[str, HandShape], "HandModel"]
"""Makes a hand of a side (``right`` or ``left``) and a shape."""


@dataclass(frozen=True, eq=False)
class HandModel:
    """Bones and skin of one hand, in hand coordinates at zero angles, mm.

    Attributes:
        anatomy: joints, segments, radii, side.
        lean: few triangles, for rendering many poses.
        smooth: more triangles, on the skin's surface, for fits and results.
        whole: makes the skin with all triangles, for pictures; None if the smooth one has them all.
    """

    anatomy: HandAnatomy
    lean: SkinnedMesh
    smooth: SkinnedMesh
    whole: Callable[[], SkinnedMesh] | None = None

    @cached_property
    def lean_with_arm(self) -> SkinnedMesh:
        """Return the lean skin with a forearm, for likelihoods that model it."""
        return with_forearm(self.lean, self.smooth, self.anatomy, *_LEAN_ARM)

    @cached_property
    def smooth_with_arm(self) -> SkinnedMesh:
        """Return the smooth skin with a forearm."""
        return with_forearm(self.smooth, self.smooth, self.anatomy, *_SMOOTH_ARM)

    def skin(self, level: str) -> SkinnedMesh:
        """Return the skin of a level: ``lean``, ``medium`` (smooth) or ``fine`` (whole)."""
        if level == "fine" and self.whole is not None:
            return self.whole()
        return self.lean if level == "lean" else self.smooth


def hand_model(settings: HandSettings) -> HandModel:
    """Return the hand of a ``[hand]`` table; a right one for side ``auto``.

    Raises:
        UsageError: ``settings.mesh`` is not a usable hand.
    """
    side = "right" if settings.side == "auto" else settings.side
    return hand_maker(settings.mesh)(side, settings.shape)


def hand_maker(mesh: str | None) -> HandMaker:
    """Return the maker of hands of any side and shape, from the average hand or from a GLB file."""
    return average_hand if mesh is None else _file_hand(Path(mesh))


def average_hand(side: str = "right", shape: HandShape | None = None) -> HandModel:
    """Return the average adult hand with a shape."""
    shape = shape or HandShape()
    anatomy = make_anatomy(
        side,
        shape.scale,
        shape.finger_lengths,
        shape.finger_widths,
        shape.palm,
        shape.wrist_width,
        shape.thumb_place,
        shape.coefficients,
    )
    smooth = hand_mesh(anatomy, "medium").grown(shape.padding_mm)

    def whole() -> SkinnedMesh:
        return hand_mesh(anatomy, "fine").grown(shape.padding_mm)

    return HandModel(anatomy, lean_mesh(anatomy, smooth), smooth, whole)


def _file_hand(path: Path) -> HandMaker:
    from posetrack_cli.hand.model.anatomy import reshaped_anatomy, reshaped_skin
    from posetrack_cli.hand.model.webxr import load_hand
    from posetrack_cli.rendering.decimation import decimated, simplified
    from posetrack_cli.rendering.gltf import damage_named

    hand = load_hand(path)
    with damage_named(path), np.errstate(all="ignore"):  # triangles without area divide by zero
        smooth = simplified(hand.skin, SMOOTH_TRIANGLES)
        if max(len(smooth.triangles), len(smooth.vertices)) > _MAX_TRIANGLES:
            what = "skin has too many separate parts to be simplified"
            raise UsageError(what, where=path, found=f"{len(smooth.triangles)} remaining triangles")
        lean = decimated(smooth, LEAN_TRIANGLES, bent_hands(hand.anatomy))
    if not (np.isfinite(smooth.vertices).all() and np.isfinite(lean.vertices).all()):
        raise UsageError("skin cannot be simplified", where=path, found="NaN vertices")

    def make(side: str, shape: HandShape) -> HandModel:
        def skin(mesh: SkinnedMesh) -> SkinnedMesh:
            return reshaped_skin(mesh, hand.anatomy, side, shape).grown(shape.padding_mm)

        anatomy = reshaped_anatomy(hand.anatomy, side, shape)
        return HandModel(anatomy, skin(lean), skin(smooth), partial(skin, hand.skin))

    return make


# Skin of the average hand: a cage over palm and fingers, and smooth surfaces through it

LEVELS = {"lean": 0, "medium": 1, "fine": 2}


def hand_mesh(anatomy: HandAnatomy, level: str = "lean") -> SkinnedMesh:
    """Return the skinned mesh of a hand at rest, hand coordinates, mm, bound to its 16 bones.

    All hands share triangles and weights; vertices are smooth functions of the shape: the population's,
    stretched with the bones (``reshaped_skin``).

    Args:
        anatomy: of ``make_anatomy``.
        level: ``lean`` (the population's cage, 410 triangles), ``medium`` (4 times, a smooth surface through
            it by Loop's scheme) or ``fine`` (16 times).
    """
    topology, own = _topology(level), make_anatomy(coefficients=anatomy.coefficients)
    cage = population().hand(anatomy.coefficients).cage
    vertices = cage if topology.refining is None else topology.refining @ cage
    skin = SkinnedMesh(vertices, topology.weights, topology.triangles)
    return reshaped_skin(skin, own, anatomy.side, shape_between(own, anatomy))


@dataclass(frozen=True)
class _Topology:
    """Shared part of the meshes of a level; ``refining`` (V, C) maps the cage to their vertices."""

    weights: FloatArray
    triangles: IntArray
    refining: FloatArray | None


@functools.cache
def _topology(level: str) -> _Topology:
    people = population()
    if LEVELS[level] == 0:
        return _Topology(people.weights, people.triangles, None)
    smooth = smoothing(people.triangles, LEVELS[level])
    return _Topology(np.asarray(smooth.blend @ people.weights), smooth.triangles, smooth.through)


# Pose space: limits, motion noise, and additive quaternions

_ABDUCTIONS = np.array(["abduction" in name for name in ANGLE_NAMES])


def inside_limits(poses: FloatArray) -> FloatArray:
    """Clamp the angles of poses (N, 22) to the joint limits."""
    out = poses.copy()
    np.clip(out[:, ANGLES], ANGLE_LIMITS[:, 0], ANGLE_LIMITS[:, 1], out=out[:, ANGLES])
    return out


class AdditiveSpace(BodySpace):
    """Poses with quaternions added componentwise, as printed in the hand paper: (44), (58) and (62).

    q becomes q + q (w, 0) / 2, its sum with its rate for a rotation vector w, normalised. Noise along q,
    which the normalisation removes, is omitted. Tangent vectors equal those of ``BodySpace`` to first order.
    """

    def retract(self, x: FloatArray, delta: FloatArray) -> FloatArray:
        """Return x (+) delta: componentwise sums, quaternions normalised with w >= 0."""
        half = np.concatenate([0.5 * delta[:, 3:6], np.ones((len(delta), 1))], axis=1)
        out = np.array(x, dtype=np.float64)
        out[:, :3] += delta[:, :3]
        out[:, 3:7] = rotations.canonical(rotations.multiply(x[:, 3:7], half))
        out[:, 7:] += delta[:, 6:]
        return out

    def local(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return y (-) x (..., 6 + K), with x (+) (y (-) x) = y; it diverges at half a turn."""
        q = rotations.multiply(rotations.conjugate(x[..., 3:7]), y[..., 3:7])
        w = np.where(np.abs(q[..., 3:]) < MIN_COSINE, np.copysign(MIN_COSINE, q[..., 3:]), q[..., 3:])
        return np.concatenate(
            [y[..., :3] - x[..., :3], 2.0 * q[..., :3] / w, y[..., 7:] - x[..., 7:]], axis=-1
        )

    def mean(self, x: FloatArray, weights: FloatArray) -> FloatArray:
        """Return the weighted mean (7 + K,), (62), with its quaternion normalised."""
        out: FloatArray = weights @ x
        out[3:7] = rotations.canonical(out[3:7])
        return out

    def log_volume(self, delta: FloatArray) -> FloatArray:
        """Return log of (1 + |w / 2|^2)^-2 (...), the change of the rotations' volume."""
        squares = 0.25 * np.einsum("...i,...i->...", delta[..., 3:6], delta[..., 3:6])
        log_volume: FloatArray = -2.0 * np.log1p(squares)
        return log_volume


MIN_COSINE = 1e-9
"""Bound on the cosine of half the angle between two rotations, to keep tangent vectors finite."""


def space_of(settings: FilterSettings) -> BodySpace:
    """Return the pose space of a filter."""
    return AdditiveSpace() if settings.rotations == "additive" else BodySpace()


def tangent_vector(components: ComponentSettings) -> FloatArray:
    """Return one number per kind of component as a tangent vector (21,)."""
    angles = np.where(_ABDUCTIONS, components.abduction_rad, components.flexion_rad)
    return np.concatenate([np.full(3, components.position_mm), np.full(3, components.rotation_rad), angles])


def pose_layout(*shape: int) -> Layout:
    """Return the layout of an array (..., 22) of poses."""
    return Layout("float64", (*shape, POSE_SIZE), unit=(3, 7))


def dynamics(config: HandConfig) -> Dynamics:
    """Return the motion model of eq. (44) with the configured noise densities."""
    settings = config.motion
    pose = settings.pose if FILTERS.find(config.filter.kind).has_velocity else settings.pose_alone
    return Dynamics(
        pose_noise=tangent_vector(pose) ** 2,
        velocity_noise=tangent_vector(settings.velocity) ** 2,
        discretisation=config.filter.discretisation,
        constrain=inside_limits if config.filter.joint_limits else None,
        gain=config.filter.gain,
    )
