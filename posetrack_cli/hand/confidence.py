"""How probable it is that an estimate is right **[ours]**.

Confidence is the probability that the mean error of the joints is below ``RIGHT_MM``, by logistic regression
on five signs, each a running mean over some five frames (``tracking.confidence``):

    logit p = w_0 + w_1 log U + w_2 log(J + 0.5) + w_3 M + w_4 c + w_5 log R

with U the usual cost of the fits, mm; J the innovation, the mean distance of the joints from where they were
expected, mm; M how many local fits explain the frame about alike; c how clearly the hand stands out
(``observer.Outline.contrast``); R what the best fit costs over what good fits of the recording do, at
least 1 (``policy.TrackMonitor.raised``). A hand that is followed well moves as expected, and one fit
explains it.

The weights were fitted by ``scripts/build confidence`` to 6,695 frames of synthetic and of real recordings,
which count alike, for rendered hands alone make one doubt real ones: 14 people of the synthetic strangers
(600-605, 610-617, motions alike, a quarter at double speed, a third from the back), each by default, with the
average hand and with the person's own; CVAR's P1, P4 and P7, offsets removed; and 24 frames of a Kinect v2's
hand that were looked at, 23 of them right. Each person left out in turn, the area under the ROC curve is .91
and the calibration error .02. Before, weights were of synthetic hands foremost, information counted, too, and
good fits were those of the frames so far: 12 and 31 per cent of P1's and P7's frames were right and below .5,
2 and 8 (of another seed 3 and 2) now, and 35 of the Kinect's 181 below .5, 7 now.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.tracking.confidence import SIGN, Regression, RunningSigns

RIGHT_MM = 20.0
_NOISE_MM, _SHIFT_PER_MM = 2.0, 0.6
SIGN_NAMES = tuple(f"{SIGN}{name}" for name in ("cost", "innovation", "fits", "contrast", "raised_cost"))
NO_SIGNS: FloatArray = np.full(len(SIGN_NAMES), np.nan)
NO_SIGNS.setflags(write=False)
REGRESSION = Regression(10.27, np.array([-1.08, -1.60, -1.40, 3.11, -7.07]))
_LEAST_COST_MM, _LEAST_INNOVATION_MM = 1.0, 0.5


def with_model_error(pose_variance: FloatArray, mean_cost_mm: float) -> FloatArray:
    """Return the variance (21,) of a pose, mm^2 and rad^2, with what the hand's shape adds to its position.

    A filter knows of the sensor's noise alone. What fits leave beyond that, as U is above 2 mm, is an error
    of the model, which shifts the hand as a whole: sd 0.6 (U - 2 mm) along each axis. With that, 90 per cent
    of the wrist's coordinates lay in their 90 per cent intervals for 14 people (600-605, 610-617, 120 frames
    each) with their own mesh, 50 without; with the average hand, whose wrist is marked elsewhere, 56.

    Args:
        pose_variance: (21,) as the filter states it.
        mean_cost_mm: U, running mean of the fits' costs.
    """
    variance = pose_variance.copy()
    variance[:3] += (_SHIFT_PER_MM * max(0.0, mean_cost_mm - _NOISE_MM)) ** 2
    return variance


def signs_of(
    mean_cost_mm: float, innovation_mm: float, fits: int, contrast: float, raised: float
) -> FloatArray:
    """Return the signs (5,) of a frame, which ``SIGN_NAMES`` name.

    Args:
        mean_cost_mm: running mean of the fits' costs.
        innovation_mm: mean distance of the joints from their prediction.
        fits: how many local fits explain the frame about alike.
        contrast: of the outline.
        raised: what the frame's best fit costs, over what good fits of the recording do, at least 1.
    """
    return np.array(
        [
            np.log(max(mean_cost_mm, _LEAST_COST_MM)),
            np.log(innovation_mm + _LEAST_INNOVATION_MM),
            float(fits),
            contrast,
            np.log(raised),
        ]
    )


NO_EVIDENCE = RunningSigns.before(len(SIGN_NAMES))


def probability(evidence: RunningSigns) -> float:
    """Return the probability that the estimate is right; 0 before the first frame."""
    return REGRESSION.probability(evidence.signs) if evidence.frames else 0.0
