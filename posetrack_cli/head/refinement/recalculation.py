"""The feature points' own places, with the pose held (thesis, 3.2.3); compiled.

Minimises E = sum_k E_k(R M'_k + t) + Student-t of M'_k - M_k, which stands for eps |M' - M|^2 of (3.3): with
patches of zero mean and unit norm, warped, and between cameras, too **[ours]**. As in (3.9) the start is
the result of the frame before. Each point is a system of three unknowns (3.17).
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import kernel
from posetrack_cli.head.refinement.evidence import gather, make_evidence, make_room
from posetrack_cli.head.refinement.joint import CONVERGED_PX, Prior, invert, tail_precision
from posetrack_cli.head.refinement.scene import Scene


@kernel
def recalculate_points(
    scene: Scene,
    rotation: FloatArray,
    position: FloatArray,
    shape: FloatArray,
    prior: Prior,
    iterations: int,
    points: FloatArray,
    correlations: FloatArray,
    pixels: FloatArray,
) -> None:
    """Descend from points (K, 3), which are written over.

    Args:
        scene: the frame.
        rotation, position: R (3, 3) and t (3,), held.
        shape: (K, 3) M, the filter's estimate, in the head's frame, mm.
        prior: of M' - M.
        iterations: steps at most.
        points: (K, 3) M' of the frame before; out: of this one.
        correlations: (C, K) out.
        pixels: (C, K, 2) out.
    """
    cameras = len(scene.images.sizes)
    evidence, room = make_evidence(cameras), make_room(cameras)
    inverse, X, d, e = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    small = CONVERGED_PX * position[2] / scene.optics.intrinsics[0, 0]
    for k in range(len(points)):
        for n in range(iterations + 1):
            transform(rotation, points[k], position, X)
            gather(scene, k, X, room, evidence)
            if n == iterations:
                break
            transform(rotation, points[k] - shape[k], np.zeros(3), d)
            weight = tail_precision(prior, k, d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
            invert(evidence.hessian, weight, inverse)
            squared = 0.0
            for i in range(3):
                e[i] = 0.0
                for j in range(3):
                    e[i] -= inverse[i, j] * (evidence.gradient[j] + weight * d[j])
                squared += e[i] ** 2
            for i in range(3):
                for j in range(3):
                    points[k, i] += rotation[j, i] * e[j]
            if squared < small * small:
                break
        correlations[:, k] = evidence.correlations
        pixels[:, k] = evidence.pixels


@kernel
def transform(R: FloatArray, v: FloatArray, t: FloatArray, out: FloatArray) -> None:
    """Write R v + t (3,)."""
    for i in range(3):
        out[i] = t[i] + R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2]
