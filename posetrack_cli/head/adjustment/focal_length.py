"""Do many views of one face fit better with another focal length? **[ours]**

A camera of another focal length sees the same face farther or nearer and otherwise nearly alike: only
perspective within the face, some 4 % at 700 mm, and its change with place and distance tell them apart.
Measured with the shipped model, 0.7 px of noise and points 0.6 mm off the model, 40 views at 600 to 900 mm
with yaw and pitch up to 35 degrees: log of the focal length to 0.12 (standard deviation); a guess that is 1.5
times too short is noticed 24 times of 25, half as long as it should be always, one that is too long never.
With yaw up to 14 degrees and no change of distance, 20 views, the log is known to 0.4, and a guess of half
the length is noticed in one of three. Of 100 people seen with the right intrinsics the gain was 2.5 at most
(3.1 where points also slid with the direction): no false alarm. Of 100 models made of random numbers one
raised one: F then has several minima.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from posetrack_cli.head.adjustment.adjuster import Adjusted, Adjuster, PersonParameters, PointView
from posetrack_cli.head.face.points import POSE_SIZE, HeadPose
from posetrack_cli.head.tracker.person import KnownPerson

WIDEST = 2.0
"""Focal lengths are tried from 1/2 to 2 of the camera's."""
ENDS, COARSE = 128, 32
"""Steps to either end; how many of them the first tries lie apart, a power of 2."""
ROUNDS = 3
"""How often it is looked about a best that turned out to be another one."""
STEP = float(np.log(WIDEST)) / ENDS
"""Of the logarithm of the factor, at the end: half a per cent."""
CLEAR_GAIN = 6.0
"""Twice the gain that errors of model and points ever made where the intrinsics were right."""

SMOOTH = 0.01
"""No views tell the logarithm better; a narrower dip is one adjustment in a minimum of its own."""


@dataclass(frozen=True)
class FocalCheck:
    """Which focal length fits best.

    Attributes:
        factor: best focal length over the camera's, from 1/2 to 2.
        gain: by how much F is lower there than with the camera as it is, over the variance of the residuals
            (taken for 1 at least): half a likelihood ratio.
        deviation: of log factor, from F's curvature; infinite at the ends. What the model is wrong by, the
            same in all views, comes on top.
    """

    factor: float
    gain: float
    deviation: float

    @property
    def is_clear(self) -> bool:
        """Whether another focal length fits so much better that no other reason is left."""
        return self.gain > CLEAR_GAIN and self.deviation > SMOOTH


def fit_focal_length(
    views: Sequence[PointView], person: PersonParameters, adjuster: Adjuster, *, iterations: int = 15
) -> FocalCheck:
    """Return which common factor on fx and fy lets the adjusted cost be least.

    It takes some thirty adjustments without bounds about the start, each from its neighbour's result.

    Args:
        views: 20 to 60 that show the face from many sides and at several distances.
        person: start.
        adjuster: with the camera whose focal length is doubted.
        iterations: of each stage of each adjustment.
    """
    fits = _Fits(adjuster, iterations)
    fits.known[0] = adjuster.adjust(views, person, iterations=2 * iterations, wide=True)
    for i in range(COARSE, ENDS + 1, COARSE):
        fits.fit(i - COARSE, i)
        fits.fit(COARSE - i, -i)
    for _ in range(ROUNDS):
        fits.refine()
        best = fits.best
        fits.walk_back()
        if fits.best == best:
            break
    return _verdict(fits)


@dataclass(frozen=True)
class _Fits:
    """Adjustments by the logarithm of the factor, in steps of ``STEP``."""

    adjuster: Adjuster
    iterations: int
    known: dict[int, Adjusted] = field(default_factory=dict)

    @property
    def best(self) -> int:
        return min(self.known, key=lambda at: self.known[at].cost)

    def fit(self, near: int, at: int) -> None:
        """Adjust with another focal length, from the result with one near it; keep what is best."""
        if abs(at) <= ENDS:
            found = self._from(near, at)
            if at not in self.known or found.cost < self.known[at].cost:
                self.known[at] = found

    def refine(self) -> None:
        """Look closer and closer about the best."""
        step = COARSE
        while step > 1:
            step //= 2
            best = self.best
            self.fit(best, best - step)
            self.fit(best, best + step)

    def walk_back(self) -> None:
        """Adjust once more from the best to the camera's own: a local minimum there is no gain."""
        near = self.best
        while near != 0:
            at = near - int(np.sign(near)) * min(abs(near), COARSE // 2)
            self.fit(near, at)
            near = at

    def _from(self, near: int, at: int) -> Adjusted:
        """Start from views as large in the image, so farther by the factor."""
        start, factor = self.known[near], float(np.exp(STEP * at))
        views = [_farther(view, float(np.exp(STEP * (at - near)))) for view in start.views]
        camera = self.adjuster.camera
        camera = replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
        adjuster = replace(self.adjuster, camera=camera)
        return adjuster.adjust(views, start.person, iterations=self.iterations, wide=True)


def _farther(view: PointView, factor: float) -> PointView:
    position = view.pose.position * np.array([1.0, 1.0, factor])
    return replace(view, pose=HeadPose(position, view.pose.quaternion))


def _verdict(fits: _Fits) -> FocalCheck:
    """Return what the costs say."""
    best = fits.best
    costs = {at: fit.cost / _variance(fits.known[best]) for at, fit in fits.known.items()}
    beside = costs.get(best - 1, np.inf) + costs.get(best + 1, np.inf)
    curvature = (beside - 2.0 * costs[best]) / STEP**2
    deviation = 1.0 / np.sqrt(curvature) if np.isfinite(curvature) and curvature > 0.0 else np.inf
    return FocalCheck(float(np.exp(STEP * best)), costs[0] - costs[best], float(deviation))


def _variance(fit: Adjusted) -> float:
    """Return 2 F over the degrees of freedom that poses and deformations leave, 1 at least."""
    seen = 2 * int(np.isfinite(fit.residuals).sum())
    freedom = seen - sum(POSE_SIZE + len(view.deformation) for view in fit.views)
    return max(1.0, 2.0 * fit.cost / max(freedom, 1))


VIEWS = 40
"""So many views of different directions can tell that a focal length is wrong; fewer are not asked."""


def focal_length_check(person: KnownPerson, adjuster: Adjuster, scale: float) -> tuple[str, ...]:
    """Return a line that says that another focal length fits better, nothing where that is not clear.

    Args:
        person: with an album of views.
        adjuster: with the camera that saw them, on images reduced by ``scale``.
        scale: of them.
    """
    views = person.album.sample(VIEWS)
    if adjuster.settings.when != "always" or len(views) < VIEWS:
        return ()
    check = fit_focal_length(views, person.person, adjuster)
    if not check.is_clear:
        return ()
    focal = adjuster.camera.fx / scale
    return (
        f"focal length {focal:.0f} px, but the points fit {check.factor * focal:.0f} px better: are the "
        "intrinsics right? z and scale depend on them",
    )
