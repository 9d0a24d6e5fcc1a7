"""Probability that an estimate is right **[ours]**.

Confidence is the probability that the mean joint error is below ``RIGHT_MM``, from logistic regression on
five signs. Each is a running mean over about five frames (``tracking.confidence``):

    logit p = w_0 + w_1 log U + w_2 log(J + 0.5) + w_3 M + w_4 c + w_5 log R

with U the mean cost of the fits, mm; J the innovation, the mean distance of the joints from their prediction,
mm; M the number of local fits of similar cost; c the contrast of the outline (``observer.Outline.contrast``);
R the ratio of the best fit's cost to that of good fits in the recording, at least 1
(``policy.TrackMonitor.cost_ratio``).

The weights were fitted by ``scripts/build confidence`` to 6,695 frames of synthetic and real recordings,
weighted equally: on rendered hands alone the regression underrates real ones. Leaving each person out in
turn, the area under the ROC curve is .91 and the calibration error .02.
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
_MIN_COST_MM, _MIN_INNOVATION_MM = 1.0, 0.5


def with_model_error(pose_variance: FloatArray, mean_cost_mm: float) -> FloatArray:
    """Return the variance (21,) of a pose, mm^2 and rad^2, including the position error of the hand's shape.

    The filter models the sensor's noise alone. The residual beyond that, U above 2 mm, is an error of the
    shape, which shifts the whole hand: sd 0.6 (U - 2 mm) along each axis. Calibrated for 90 % coverage of the
    wrist's coordinates with the person's own mesh.

    Args:
        pose_variance: (21,) of the filter.
        mean_cost_mm: U, running mean of the fits' costs.
    """
    variance = pose_variance.copy()
    variance[:3] += (_SHIFT_PER_MM * max(0.0, mean_cost_mm - _NOISE_MM)) ** 2
    return variance


def signs_of(
    mean_cost_mm: float, innovation_mm: float, fits: int, contrast: float, cost_ratio: float
) -> FloatArray:
    """Return the signs (5,) of a frame, in the order of ``SIGN_NAMES``.

    Args:
        mean_cost_mm: running mean of the fits' costs.
        innovation_mm: mean distance of the joints from their prediction.
        fits: number of local fits of similar cost.
        contrast: of the outline.
        cost_ratio: of the best fit's cost to that of good fits in the recording, at least 1.
    """
    return np.array(
        [
            np.log(max(mean_cost_mm, _MIN_COST_MM)),
            np.log(innovation_mm + _MIN_INNOVATION_MM),
            float(fits),
            contrast,
            np.log(cost_ratio),
        ]
    )


NO_EVIDENCE = RunningSigns.before(len(SIGN_NAMES))


def probability(evidence: RunningSigns, shape_doubt: float = 0.0) -> float:
    """Return the probability that the estimate is right; 0 before the first frame.

    Args:
        evidence: running signs.
        shape_doubt: reduction of the log odds.
    """
    regression = REGRESSION._replace(bias=REGRESSION.bias - shape_doubt)
    return regression.probability(evidence.signs) if evidence.frames else 0.0
