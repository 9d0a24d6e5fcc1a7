"""How probable it is that a head's estimate is right **[ours]**.

Confidence is the probability that the head's rotation is right to ``RIGHT_DEG`` and its points, on average,
to ``RIGHT_MM`` in the head (``head.subject``). Where the head's frame sits and which places its points mark
are conventions: the errors meant are those beside their constant offsets. It is a logistic regression on
running means (``tracking.confidence``) of

    misfit          log (r + .4)    r the root mean square distance of the points from where the face's model
                                    has them, % of the eyes' distance
    smallness       log (80 / e)    e the eyes' distance, pixels, of a face that looks at the camera
    unsteadiness    log (u + .2)    u how many degrees off the head is from where its velocity led
    unseen          1 - W           W how much the points counted on average, 0 (hidden or unlike) to 1
    unmatched       1 - M           M how much of the skin looked for was found again; in the second pass of
                                    one camera, else 0 with a weight of 0

The weights were fitted (``scripts/build confidence``) to twelve rendered heads (person-a to person-l of the
study) and five drawn ones, as they are, which count four times, and the rendered ones also at .3 of their
size and with their eyes 44, 31 and 22 pixels apart, blurred and three times as fast, with something passing
before the face, and dark and noisy, for as they are few frames are wrong: none with one camera that knows the
skin, 2 % without and with two. One camera was told nothing that was learned from the person tracked (but a
and b), and went over all of them in two passes, with the skin and without. With it four videos of real faces
count a quarter as much as all of these, three of them also at every second and fourth frame: rendered heads
alone make one doubt real ones, of which right frames fit worse. Their reference are the points of another
detector and the pose that they tell; that errs by 1.4 to 4 degrees, so frames that differ by 6 to 9 do not
count. Each person left out in turn, the area under the ROC curve of one camera with skin is .88 in all (.83
without the fifth sign; calibration error .004) and .96 (.04) of the real ones alone, without skin .78 (.02)
in all and .86 (.04) as they are. With two cameras they are .81 (.02) in all and .84 (.01).
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.initialisation.mono import EYE_DISTANCE_MM, eye_distance_px
from posetrack_cli.head.subject import SIGNS
from posetrack_cli.head.tracker.frame_tracker import FrameFit, TrackRecord, TrackState
from posetrack_cli.tracking.confidence import PROBABLY, Regression

MONO = Regression(4.43, np.array([-0.75, -0.59, -0.17, -9.04, 0.0]))
MONO_WITH_SKIN = Regression(7.64, np.array([0.0, -0.12, -0.03, -5.27, -7.24]))
STEREO = Regression(3.70, np.array([-1.22, -1.00, -1.54, -7.07, 0.0]))
_USUAL_PX, _STEADY_DEG, _EXACT = 80.0, 0.2, 0.4
_LONGEST_S = 0.2
"""A gap counts for no longer, as velocities do not last."""


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


def signs_of(before: TrackState | None, fit: FrameFit, stated: FrameFit, camera: Camera) -> FloatArray:
    """Return the signs (5,) of a frame in which a head was followed.

    Args:
        before: the head after the frame before; None without.
        fit: of the frame, by its feature points.
        stated: of the frame, where the skin may tell, too.
        camera: of the recorded image, the reference.
    """
    track = fit.track
    beside = track.shape - track.particles.model.shapes(fit.coefficients)
    seen = (fit.weights > 0.0) & np.isfinite(fit.pixels).all(axis=2).any(axis=0)
    rms = float(np.sqrt(np.mean(np.sum(beside[seen] ** 2, axis=1)))) if seen.any() else EYE_DISTANCE_MM
    return np.array(
        [
            np.log(100.0 * rms / EYE_DISTANCE_MM + _EXACT),
            np.log(_USUAL_PX / eye_distance_px(track.pose, camera)),
            np.log(_off_deg(before, fit) + _STEADY_DEG),
            1.0 - float(fit.weights.mean()),
            0.0 if stated.unmatched is None else stated.unmatched,
        ]
    )


def _off_deg(before: TrackState | None, fit: FrameFit) -> float:
    """By how much the head turned otherwise than in the frame before."""
    velocity = np.zeros(3) if before is None else before.velocity[3:]
    turned = np.linalg.norm(fit.track.velocity[3:] - velocity) * min(fit.dt, _LONGEST_S)
    return float(np.degrees(turned))
