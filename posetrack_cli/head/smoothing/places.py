"""Where a face's points are in a smoothed head, and which deformation that is **[ours]**.

A point that was found in a frame is where it was found, whatever pose the head had: in the smoothed head it
has another place, m_k + d_k. Of one camera it lies on its ray, as deep as the neutral face has it. These
displacements move faster than the head, so each is smoothed by itself: at a frame it is the value of the
line, by weighted least squares, through its neighbours (local linear regression; Cleveland 1979), weighted
by how well the point was seen and by a Gaussian of the time between. Its slope is the displacement's rate.

The deformation's coefficients are those that come nearest to the places:

    a = argmin |V a - d|^2 / n^2 + sum_b (a_b / mu_b)^2
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.smoothing import Memory, Smoothed
from posetrack_cli.geometry.rigid import in_camera, in_object
from posetrack_cli.head.smoothing.fits import LEAST_DEVIATION_MM, NOISE_MM
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.tracking.body_space import pose_rates
from posetrack_cli.tracking.smoothing import FrameFacts
from posetrack_cli.units import NS_PER_S

PLACES_S = 0.05
"""Standard deviation of the Gaussian: places in the face are smoothed over so long."""
REACH = 3.0
"""Times the Gaussian's standard deviation: frames farther away do not count."""
LEAST_SHARE = 1e-3
"""Of the weight of a point that is not seen: alone it stays where the tracker left it."""
FLAT = 0.01
"""Of the Gaussian's variance, added to that of the times: a frame without neighbours has a flat line."""


class PosedFrame(NamedTuple):
    """A frame whose pose is smoothed, and whose points are yet to be.

    Attributes:
        facts: what its estimate says of it.
        pose: (7,), with
        variance: (6,), and
        velocity: (6,), with
        velocity_variance: (6,).
        displacements: (K, 3) mm, d in the head's frame.
        weights: (K,) how much each counts.
        memory: the frame's, with the face.
    """

    facts: FrameFacts
    pose: FloatArray
    variance: FloatArray
    velocity: FloatArray
    velocity_variance: FloatArray
    displacements: FloatArray
    weights: FloatArray
    memory: Memory


def posed_frame(smoothed: Smoothed, facts: FrameFacts, memory: Memory, cameras: int) -> PosedFrame:
    """Return a frame with its smoothed pose; as its chain was gone through backwards, so are velocities."""
    pose, neutral = smoothed.pose, memory["neutral"]
    points = memory["points"]
    if cameras == 1:
        depths = in_camera(neutral, pose[:3], pose[3:7])[:, 2:]
        points = points * (depths / points[:, 2:])
    weights = np.maximum(memory["weights"] if memory["seen"] else 0.0, LEAST_SHARE) * np.ones(len(neutral))
    return PosedFrame(
        facts,
        pose,
        smoothed.pose_variance + memory["systematic"],
        -smoothed.velocity,
        smoothed.velocity_variance,
        in_object(points, pose[:3], pose[3:7]) - neutral,
        weights,
        memory,
    )


def with_places(frames: Iterable[PosedFrame], origin: FloatArray) -> Iterator[Estimate]:
    """Yield the estimates of frames whose points are smoothed.

    Args:
        frames: in the order of time; those of other chains are no neighbours.
        origin: (B,) what the coefficients of the neutral face are called in results.
    """
    window, done = list[PosedFrame](), 0
    reach = REACH * PLACES_S
    for frame in frames:
        if window and window[-1].memory["chain"] != frame.memory["chain"]:
            yield from (_estimate(window, index, origin) for index in range(done, len(window)))
            window, done = [], 0
        window.append(frame)
        while _seconds(window[done], frame) > reach:
            yield _estimate(window, done, origin)
            done += 1
        while _seconds(window[0], window[done]) > reach:
            window, done = window[1:], done - 1
    yield from (_estimate(window, index, origin) for index in range(done, len(window)))


def _seconds(earlier: PosedFrame, later: PosedFrame) -> float:
    return (later.facts.stamp_ns - earlier.facts.stamp_ns) / NS_PER_S


def _estimate(window: list[PosedFrame], index: int, origin: FloatArray) -> Estimate:
    """The estimate of one frame among its neighbours."""
    frame = window[index]
    displacements, rates = local_line(
        np.array([_seconds(frame, one) for one in window]),
        np.array([one.displacements for one in window]),
        np.array([one.weights for one in window]),
        PLACES_S,
    )
    coefficients, coefficient_rates, variance = _deformation(frame.memory, displacements, rates)
    twist = np.concatenate([frame.velocity, coefficient_rates])
    pose = np.concatenate([frame.pose, origin + coefficients])
    places = frame.memory["neutral"] + displacements
    return Estimate(
        **frame.facts._asdict(),
        position=pose[:3],
        quaternion=pose[3:7],
        shape=pose[7:],
        pose_rate=pose_rates(pose, twist),
        twist=twist,
        pose_variance=np.concatenate([frame.variance, variance]),
        twist_variance=np.concatenate([frame.velocity_variance, variance / PLACES_S**2]),
        points=in_camera(places, pose[:3], pose[3:7]),
        effective_sample_size=None,
        resampled=False,
    )


def local_line(
    times: FloatArray, values: FloatArray, weights: FloatArray, width: float
) -> tuple[FloatArray, FloatArray]:
    """Return value and slope at time 0 of the lines through K points' values, each (K, D).

    Args:
        times: (N,) s.
        values: (N, K, D).
        weights: (N, K), above 0 for some frame of each point.
        width: of the Gaussian of times, s, one standard deviation.
    """
    shares = weights * np.exp(-0.5 * np.square(times / width))[:, None]
    zeroth, first = shares.sum(axis=0)[:, None], (times @ shares)[:, None]
    second = (np.square(times) @ shares)[:, None] + FLAT * width**2 * zeroth
    sums = np.einsum("nk,nkd->kd", shares, values)
    moments = np.einsum("n,nk,nkd->kd", times, shares, values)
    determinant = zeroth * second - first**2
    return (second * sums - first * moments) / determinant, (zeroth * moments - first * sums) / determinant


def _deformation(
    memory: Memory, displacements: FloatArray, rates: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the coefficients (B,) of displacements (K, 3), their rates and their variances."""
    basis = memory["basis"].reshape(displacements.size, -1)
    precision = np.maximum(memory["deviations"], LEAST_DEVIATION_MM) ** -2
    information = basis.T @ basis / NOISE_MM**2 + np.diag(precision)
    covariance = np.linalg.inv(information)
    onto = covariance @ basis.T / NOISE_MM**2
    return onto @ displacements.ravel(), onto @ rates.ravel(), np.diag(covariance).copy()
