"""Confidence of a hand's pose, and the evidence for it."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan, degrees

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.observe.detection import Detection, detect
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.camera_of import principal_point_fault
from posetrack_cli.recording.depth import MM_PER_M, Depth, content_of, length_words, likely_units, range_words
from posetrack_cli.recording.recording import Recording
from posetrack_cli.tracking.confidence import SIGN, Regression, RunningSigns

# What depth images show of which no or hardly any frame was tracked, and the likeliest reason


NARROWEST_DEG, WIDEST_DEG = 15.0, 150.0
"""Fields of view that depth cameras have: from 40 to 120 degrees."""
_MANY = 0.5
"""Share of frames with a region like a hand, from which on the hand is there and does not fit."""


_ALL_PIXELS = 0.9999
"""Share of pixels with a value, of brightness: depth lacks readings at edges and in shadows."""


class DepthEvidence:
    """What some frames of a recording show.

    Args:
        recording: that they are of.
        config: of the run.
        frames: a few of its frames.
    """

    def __init__(self, recording: Recording, config: HandConfig, frames: Sequence[Frame]) -> None:
        self._camera, self._config, self._frames = recording.cameras[0], config, frames
        pixels = recording.pixels[0]
        self._unit_mm = pixels.unit_mm if isinstance(pixels, Depth) else 1.0
        self.content = content_of((frame.depth for frame in frames), self._camera)
        self._hands = [detect(frame.depth, self._camera, config.detection) for frame in frames]

    @property
    def line(self) -> str:
        """What was seen, and the likeliest reason if there is evidence for one."""
        return f"{self.seen}{f'; {self.reason}' if self.reason else ''}"

    @property
    def seen(self) -> str:
        """Say in how many frames there is a region like a hand, at which depths, and how large it is."""
        if not self.content.images:
            return f"no reading in the {len(self._frames)} frames looked at"
        found = [hands for hands in self._hands if hands]
        where = f"depths lie at {self.content.range_words(1.0)}"
        if not found:
            size = f"the nearest surface, {length_words(self.content.surface)} across"
            return f"no region like a hand in the {len(self._frames)} frames looked at; {where}, {size}"
        palms: list[Detection] = [hand for hands in found for hand in hands]
        depths = np.percentile([float(hand.palm[2]) for hand in palms], (10, 90))
        radius = float(np.median([hand.palm_radius_mm for hand in palms]))
        at = f"at {range_words(float(depths[0]), float(depths[1]))}"
        of = f"{len(found)} of the {len(self._frames)} frames looked at"
        return f"a region like a hand in {of}, {at}, palm radius {radius:.0f} mm; {where}"

    @property
    def reason(self) -> str:
        """The likeliest reason, with the option that mends it; empty without evidence for one."""
        if not self.content.images:
            return ""
        return self._of_camera or self._of_unit or self._of_hand or self._of_brightness

    @property
    def is_in_range(self) -> bool:
        """Whether some depths are where hands are searched for."""
        low, high = self._config.detection.nearest_mm, self._config.detection.farthest_mm
        return bool(self.content.images) and self.content.near <= high and self.content.far >= low

    @property
    def _of_camera(self) -> str:
        camera = self._camera
        size = f"{camera.width}x{camera.height}"
        fault = principal_point_fault(camera)
        if fault is not None:
            where = f"({camera.cx:.0f}, {camera.cy:.0f}) in {size}"
            return f"the principal point is {fault}, {where}: --camera with the camera of these images"
        angle = degrees(2.0 * atan(0.5 * camera.width / camera.fx))
        if NARROWEST_DEG <= angle <= WIDEST_DEG:
            return ""
        view = f"a focal length of {camera.fx:.0f} px is a field of view of {angle:.0f} degrees"
        return f"{view} in {size}: --camera with the camera of these images"

    @property
    def _of_unit(self) -> str:
        content, detection = self.content, self._config.detection
        units = likely_units(content, self._unit_mm)
        if self._unit_mm in units and self.is_in_range:
            return ""
        known = f"depth was read as {self._unit_mm:g} mm per stored unit"
        fitting = " or ".join(f"{unit:g}" for unit in units)
        if not self.is_in_range:
            low, high = detection.nearest_mm / MM_PER_M, detection.farthest_mm / MM_PER_M
            searched = f"hands are searched for from {low:g} to {high:g} m"
            advice = f"--depth-unit-mm {fitting} would fit" if units else "--depth-unit-mm states another"
            return f"{searched}, and {known}: {advice}"
        if units and not any(self._hands):
            size = f"the nearest surface is {length_words(content.surface)} across"
            return f"{size}, and {known}: with --depth-unit-mm {fitting} it would be as large as a hand"
        return ""

    @property
    def _of_brightness(self) -> str:
        if self.content.share < _ALL_PIXELS:
            return ""
        return "every pixel has a value, as brightness has and depth hardly: are these images infrared?"

    @property
    def _of_hand(self) -> str:
        hand = self._config.hand
        if sum(map(bool, self._hands)) < _MANY * max(1, len(self._hands)):
            return ""
        stated = [f"a {hand.side} hand (--hand-side)"] if hand.side != "auto" else []
        stated += [f"of scale {hand.scale:g} (--scale)"] if hand.scale != 1.0 else []
        taken = " ".join(stated) or "the average hand"
        return f"they do not fit {taken}, or the intrinsics are of another image"


# How probable it is that an estimate is right **[ours]**.
#
# Confidence is the probability that the mean error of the joints is below ``RIGHT_MM``, by logistic
# regression on five signs, each a running mean over some five frames (``tracking.confidence``):
#
#     logit p = w_0 + w_1 log U + w_2 log(J + 0.5) + w_3 M + w_4 c + w_5 log R
#
# with U the usual cost of the fits, mm; J the innovation, the mean distance of the joints from where they
# were expected, mm; M how many local fits explain the frame about alike; c how clearly the hand stands out
# (``observer.Outline.contrast``); R what the best fit costs over what good fits of the recording do, at least
# 1 (``policy.TrackMonitor.raised``). A hand that is followed well moves as expected, and one fit explains it.
#
# The weights were fitted by ``scripts/build confidence`` to 6,695 frames of synthetic and of real recordings,
# which count alike, for rendered hands alone make one doubt real ones: 14 people of the synthetic strangers
# (600-605, 610-617, motions alike, a quarter at double speed, a third from the back), each by default, with
# the average hand and with the person's own; CVAR's P1, P4 and P7, offsets removed; and 24 frames of a Kinect
# v2's hand that were looked at, 23 of them right. Each person left out in turn, the area under the ROC curve
# is .91 and the calibration error .02. Before, weights were of synthetic hands foremost, information counted,
# too, and good fits were those of the frames so far: 12 and 31 per cent of P1's and P7's frames were right
# and below .5, 2 and 8 (of another seed 3 and 2) now, and 35 of the Kinect's 181 below .5, 7 now.


RIGHT_MM = 20.0
_NOISE_MM, _SHIFT_PER_MM = 2.0, 0.6
SIGN_NAMES = tuple(f"{SIGN}{name}" for name in ("cost", "innovation", "fits", "contrast", "raised_cost"))
NO_SIGNS: FloatArray = np.full(len(SIGN_NAMES), np.nan)
NO_SIGNS.setflags(write=False)
REGRESSION = Regression(10.27, np.array([-1.08, -1.60, -1.40, 3.11, -7.07]))
_LEAST_COST_MM, _LEAST_INNOVATION_MM = 1.0, 0.5


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


def signs_of(usual_mm: float, innovation_mm: float, fits: int, contrast: float, raised: float) -> FloatArray:
    """Return the signs (5,) of a frame, which ``SIGN_NAMES`` name.

    Args:
        usual_mm: running mean of the fits' costs.
        innovation_mm: mean distance of the joints from their prediction.
        fits: how many local fits explain the frame about alike.
        contrast: of the outline.
        raised: what the frame's best fit costs, over what good fits of the recording do, at least 1.
    """
    return np.array(
        [
            np.log(max(usual_mm, _LEAST_COST_MM)),
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
