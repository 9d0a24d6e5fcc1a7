"""How probable it is that an estimate is right **[ours]**.

Confidence is the probability that the mean error of the joints is below ``RIGHT_MM``, by logistic regression
on seven signs, each a running mean over some five frames (``tracking.confidence``):

    logit p = w_0 + w_1 log U + w_2 log(J + 0.5) + w_3 M + w_4 a + w_5 p + w_6 c + w_7 log R

with U the usual cost of the fits, mm; J the innovation, the mean distance of the joints from where they were
expected, mm; M how many local fits explain the frame about alike; a and p the mean of log10 of the best fit's
information about the angles, 1 / rad^2, and about the position, 1 / mm^2; c how clearly the hand stands out
(``observer.Outline.contrast``); R what the best fit costs over what good fits of the recording do, at
least 1. A hand that is followed well moves as expected, and one fit explains it.

The first six weights were fitted to 4,200 frames, every recording counting alike: 14 people of the synthetic
strangers (600-605, 610-617, motions alike), each with the average hand and with the person's own, four of
them calibrated, and CVAR's P1, P4 and P7 with the average hand. Each person left out in turn, the area under
the ROC curve is .92, and .84 of the average hand's frames alone; stated probabilities differ from the shares
of right frames by at most .1 where there are many, by .2 between .2 and .4, where fewer are right than said.
Of these frames 1 in 700 is more than 40 mm off and above .5, and 1 in 80 right and below. The seventh, with
the others held, is from 6,671 frames of the same people and recordings as they are tracked now
(``scripts/hand-confidence`` reads such results): .4 per cent of all frames are more than 40 mm off and above
.5 instead of .8, and with offsets removed the area is .82 instead of .80 within P1 and .58 instead of .52
within P7. Larger weights doubt more of what is right.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.tracking.confidence import SIGN, Regression, RunningSigns

RIGHT_MM = 20.0
_NOISE_MM, _SHIFT_PER_MM = 2.0, 0.6
SIGN_NAMES = tuple(
    f"{SIGN}{name}"
    for name in (
        "cost",
        "innovation",
        "fits",
        "angle_information",
        "position_information",
        "contrast",
        "raised_cost",
    )
)
NO_SIGNS: FloatArray = np.full(len(SIGN_NAMES), np.nan)
NO_SIGNS.setflags(write=False)
REGRESSION = Regression(9.98, np.array([-1.94, -1.51, -1.04, 1.06, -3.19, 1.56, -3.0]))
_LEAST_COST_MM, _LEAST_INNOVATION_MM, _LEAST_INFORMATION = 1.0, 0.5, 1e-9


def with_model_error(pose_variance: FloatArray, usual_mm: float) -> FloatArray:
    """Return the variance (21,) of a pose, mm^2 and rad^2, with what the hand's shape adds to its position.

    A filter knows of the sensor's noise alone. What fits leave beyond that, as U is above 2 mm, is an error
    of the model, which shifts the hand as a whole: sd 0.6 (U - 2 mm) along each axis. With that, 90 per cent
    of the wrist's coordinates lay in their 90 per cent intervals for 14 people (600-605, 610-617, 120 frames
    each) with their own mesh, 50 without; with the average hand, whose wrist is marked elsewhere, 56.

    Args:
        pose_variance: (21,) as the filter states it.
        usual_mm: U, running mean of the fits' costs.
    """
    variance = pose_variance.copy()
    variance[:3] += (_SHIFT_PER_MM * max(0.0, usual_mm - _NOISE_MM)) ** 2
    return variance


def signs_of(
    usual_mm: float, innovation_mm: float, modes: LikelihoodModes, contrast: float, raised: float
) -> FloatArray:
    """Return the signs (7,) of a frame, which ``SIGN_NAMES`` name.

    Args:
        usual_mm: running mean of the fits' costs.
        innovation_mm: mean distance of the joints from their prediction.
        modes: the frame's local fits, the best first.
        contrast: of the outline.
        raised: what the frame's best fit costs, over what good fits of the recording do.
    """
    information = np.log10(np.maximum(np.diagonal(modes.information[0]), _LEAST_INFORMATION))
    return np.array(
        [
            np.log(max(usual_mm, _LEAST_COST_MM)),
            np.log(innovation_mm + _LEAST_INNOVATION_MM),
            float(len(modes)),
            information[6:].mean(),
            information[:3].mean(),
            contrast,
            np.log(max(raised, 1.0)),
        ]
    )


NO_EVIDENCE = RunningSigns.before(len(SIGN_NAMES))


def probability(evidence: RunningSigns) -> float:
    """Return the probability that the estimate is right; 0 before the first frame."""
    return REGRESSION.probability(evidence.signs) if evidence.frames else 0.0
