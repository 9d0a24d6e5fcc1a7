"""Check of the focal length against many views of one face **[ours]**.

A wrong focal length mostly scales the face's distance. Only perspective within the face, some 4 % at 700 mm,
and its change with position and distance reveal it. With 40 varied views the standard deviation of the
logarithm is about 0.12. Too long focal lengths are never detected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from posetrack_cli.head.adjustment.adjuster import Adjusted, Adjuster, PersonParameters, PointView
from posetrack_cli.head.face.points import POSE_SIZE, HeadPose
from posetrack_cli.head.tracker.person import KnownPerson

WIDEST = 2.0
"""Focal lengths are tried from 1/2 to 2 times the camera's."""
ENDS, COARSE = 128, 32
"""Steps to either end; spacing of the coarse search, a power of 2."""
ROUNDS = 3
"""Maximum number of refinements when the best focal length changes."""
STEP = float(np.log(WIDEST)) / ENDS
"""Resolution of the logarithm of the factor: half a per cent."""
CLEAR_GAIN = 6.0
"""Twice the largest gain observed with correct intrinsics."""
SMOOTH = 0.01
"""Least plausible standard deviation; a narrower minimum is an artefact of a single adjustment."""


@dataclass(frozen=True)
class FocalCheck:
    """Best focal length and its evidence.

    Attributes:
        factor: best focal length relative to the camera's, from 1/2 to 2.
        gain: decrease of F relative to the camera's focal length, over the residual variance (at least 1):
            half a likelihood ratio.
        deviation: of log factor, from F's curvature; infinite at the ends. Errors of the model, common to all
            views, are not included.
    """

    factor: float
    gain: float
    deviation: float

    @property
    def is_clear(self) -> bool:
        """Whether the evidence rules out other causes."""
        return self.gain > CLEAR_GAIN and self.deviation > SMOOTH


def fit_focal_length(
    views: Sequence[PointView], person: PersonParameters, adjuster: Adjuster, *, iterations: int = 15
) -> FocalCheck:
    """Find the common factor on fx and fy with the least adjusted cost.

    Takes some thirty adjustments without bounds about the start, each starting from its neighbour's result.

    Args:
        views: 20 to 60 from many directions and at several distances.
        person: start.
        adjuster: with the camera to check.
        iterations: of each stage of each adjustment.
    """
    fits = _FocalFits(adjuster, iterations)
    fits.known[0] = adjuster.adjust(views, person, iterations=2 * iterations, wide=True)
    # outwards from the camera's focal length, each fit starting from its neighbour
    for i in range(COARSE, ENDS + 1, COARSE):
        fits.fit(i - COARSE, i)
        fits.fit(COARSE - i, -i)
    for _ in range(ROUNDS):
        fits.refine()
        best = fits.best
        fits.walk_back()
        if fits.best == best:
            break
    return _summary(fits)


@dataclass(frozen=True)
class _FocalFits:
    """Adjustments by the logarithm of the factor, in steps of ``STEP``."""

    adjuster: Adjuster
    iterations: int
    known: dict[int, Adjusted] = field(default_factory=dict)

    @property
    def best(self) -> int:
        return min(self.known, key=lambda at: self.known[at].cost)

    def fit(self, near: int, at: int) -> None:
        """Adjust with another focal length, starting from a neighbouring result; keep the better one."""
        if abs(at) <= ENDS:
            found = self._from(near, at)
            if at not in self.known or found.cost < self.known[at].cost:
                self.known[at] = found

    def refine(self) -> None:
        """Bisect the interval about the best."""
        step = COARSE
        while step > 1:
            step //= 2
            best = self.best
            self.fit(best, best - step)
            self.fit(best, best + step)

    def walk_back(self) -> None:
        """Repeat adjustments from the best back to the camera's focal length.

        Otherwise a local minimum of the first adjustment would count as a gain.
        """
        near = self.best
        while near != 0:
            at = near - int(np.sign(near)) * min(abs(near), COARSE // 2)
            self.fit(near, at)
            near = at

    def _from(self, near: int, at: int) -> Adjusted:
        """Start from views at distances scaled by the factor, which keeps the image size."""
        start, factor = self.known[near], float(np.exp(STEP * at))
        views = [_at_scaled_depth(view, float(np.exp(STEP * (at - near)))) for view in start.views]
        camera = self.adjuster.camera
        camera = replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
        adjuster = replace(self.adjuster, camera=camera)
        return adjuster.adjust(views, start.person, iterations=self.iterations, wide=True)


def _at_scaled_depth(view: PointView, factor: float) -> PointView:
    position = view.pose.position * np.array([1.0, 1.0, factor])
    return replace(view, pose=HeadPose(position, view.pose.quaternion))


def _summary(fits: _FocalFits) -> FocalCheck:
    best = fits.best
    costs = {at: fit.cost / _variance(fits.known[best]) for at, fit in fits.known.items()}
    neighbours = costs.get(best - 1, np.inf) + costs.get(best + 1, np.inf)
    curvature = (neighbours - 2.0 * costs[best]) / STEP**2
    deviation = 1.0 / np.sqrt(curvature) if np.isfinite(curvature) and curvature > 0.0 else np.inf
    return FocalCheck(float(np.exp(STEP * best)), costs[0] - costs[best], float(deviation))


def _variance(fit: Adjusted) -> float:
    """Return 2 F over the degrees of freedom left by poses and deformations, at least 1."""
    seen = 2 * int(np.isfinite(fit.residuals).sum())
    freedom = seen - sum(POSE_SIZE + len(view.deformation) for view in fit.views)
    return max(1.0, 2.0 * fit.cost / max(freedom, 1))


VIEWS = 40
"""Minimum number of views to detect a wrong focal length."""


def focal_length_check(person: KnownPerson, adjuster: Adjuster, scale: float) -> tuple[str, ...]:
    """Return a warning if another focal length fits clearly better.

    Args:
        person: with an album of views.
        adjuster: with the camera, on images scaled by ``scale``.
        scale: of the images.
    """
    views = person.album.sample(VIEWS)
    if adjuster.settings.when != "always" or len(views) < VIEWS:
        return ()
    check = fit_focal_length(views, person.person, adjuster)
    if not check.is_clear:
        return ()
    focal = adjuster.camera.fx / scale
    return (
        f"focal length is {focal:.0f} px, but the points fit {check.factor * focal:.0f} px better: check the "
        "intrinsics; z and scale depend on them",
    )
