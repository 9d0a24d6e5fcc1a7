"""How probable it is that a head's estimate is right **[ours]**.

Confidence is the probability that the head's rotation is right to ``RIGHT_DEG`` and its points, on average,
to ``RIGHT_MM`` in the head, each beside one constant rigid offset of the head's frame, which is a convention:
logistic regression (``tracking.confidence``) on

    sqrt(r phi)         r the root mean square distance of the points from where the adjusted face has them, %
                        of the eyes' distance; phi the face's angle to the camera, tens of degrees
    80 / e              e the eyes' distance on the image, pixels, as if the face looked at the camera
    mean log (u + .2)   u how many degrees off the head is from where its velocity led; a running mean
    max(l - .25, 0)     l what the points' mean correlation lacks of 1
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.subject import SIGNS
from posetrack_cli.head.tracker.face_learning import off_axis_deg
from posetrack_cli.head.tracker.frame_tracker import FrameFit, TrackRecord, TrackState
from posetrack_cli.tracking.confidence import PROBABLY, Regression, RunningSigns

RIGHT_DEG, RIGHT_MM = 3.0, 5.0
"""As ``posetrack eval`` has them."""
MONO = Regression(6.0, np.array([-2.0, -1.0, -1.0, -5.0]))
STEREO = MONO
EYES_MM = 63.0
_USUAL_PX, _STEADY_DEG, _LIKE, _LONGEST_S = 80.0, 0.2, 0.25, 0.2
"""The last: a gap counts for no longer, as velocities do not last."""


NO_SIGNS: FloatArray = np.full(len(SIGNS), np.nan)
NO_SIGNS.setflags(write=False)
DOUBTFUL_SHARE, LONG_S = 0.1, 1.0
"""More doubtful frames than this, and a head that was gone for longer, are told at a run's end."""


def doubts(record: TrackRecord) -> tuple[str, ...]:
    """Return what to know of a track at its end, in one line with what may help; () of a good one."""
    found = []
    if record.doubtful > DOUBTFUL_SHARE * record.frames:
        found.append(
            f"{record.doubtful} of {record.frames} frames are more probably wrong than right (confidence"
            f" below {PROBABLY:g})"
        )
    if record.gap_ns > LONG_S * 1e9:
        found.append(f"no face for {record.gap_ns * 1e-9:.1f} s after frame {record.gap_frame}")
    if not found:
        return ()
    help_ = "posetrack view shows them; larger, sharper images of the whole face help, and so do --landmarks"
    return (f"{'; '.join(found)}: {help_}",)


def unsteadiness(before: TrackState | None, fit: FrameFit) -> FloatArray:
    """Return (1,) log (u + .2) of a frame, given the head in the frame before."""
    velocity = np.zeros(6) if before is None else before.velocity
    turned = np.linalg.norm(fit.track.velocity[3:] - velocity[3:]) * min(fit.dt, _LONGEST_S)
    return np.array([np.log(np.degrees(turned) + _STEADY_DEG)])


def signs_of(fit: FrameFit, focal_px: float, steady: RunningSigns) -> FloatArray:
    """Return the signs (4,) of a frame in which a head was tracked.

    Args:
        fit: of the frame.
        focal_px: of the recorded image.
        steady: running mean of the unsteadiness, with this frame's.
    """
    track = fit.track
    beside = track.shape - track.particles.model.shapes(fit.coefficients)
    seen = (fit.weights > 0.0) & np.isfinite(fit.pixels).all(axis=2).any(axis=0)
    rms = float(np.sqrt(np.mean(np.sum(beside[seen] ** 2, axis=1)))) if seen.any() else EYES_MM
    turned = off_axis_deg(track.pose) / 10.0
    return np.array(
        [
            np.sqrt(100.0 * rms / EYES_MM * turned),
            _USUAL_PX * max(float(track.pose.position[2]), 1.0) / (EYES_MM * focal_px),
            float(steady.signs[0]) if steady.frames else np.log(_STEADY_DEG),
            max(1.0 - fit.score - _LIKE, 0.0),
        ]
    )
