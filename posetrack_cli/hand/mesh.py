"""The hand's skin: one closed mesh over palm and five fingers, a cage and smooth surfaces through it."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.hand.anatomy import HandAnatomy, make_anatomy
from posetrack_cli.hand.population import population
from posetrack_cli.hand.shape import reshaped_skin, shape_between
from posetrack_cli.rendering.mesh import SkinnedMesh, smoothing

LEVELS = {"lean": 0, "medium": 1, "fine": 2}


def hand_mesh(anatomy: HandAnatomy, level: str = "lean") -> SkinnedMesh:
    """The skinned mesh of a hand in its rest pose, hand coordinates, mm, bound to its 16 bones.

    All hands have the same triangles and weights, and vertices that are smooth functions of the shape: the
    population's, stretched with the bones (``reshaped_skin``).

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
    """What all hands' meshes of a level share; ``refining`` (V, C) makes their vertices of the cage's."""

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
