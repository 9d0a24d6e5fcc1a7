"""What a one-camera result holds beside the pose: deformation, identity, and how the two were found.

``Estimate.shape`` holds the A' deformation parameters a of (4.15), without unit. ``Estimate.points`` are the
recalculated points m^ at the depths that the adjusted face has. The further numbers tell who the person is
taken for: the identity parameters s, and how far they moved over the last adjustments.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face import POINT_COUNT, POINT_NAMES
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.subject import WEIGHT, head_subject
from posetrack_cli.results.estimate import Subject


def mono_subject(camera_frame: str, model: FaceModel) -> Subject:
    """Return the subject of a head that one camera sees."""
    return head_subject(camera_frame, model.deformation_size, mono_number_names(model.identity_size))


def mono_number_names(identities: int) -> tuple[str, ...]:
    """Return the names of the M = 2 S' + 4 + K further numbers, in the order of ``MonoNumbers.array``."""
    return (
        *(f"identity_{s + 1}" for s in range(identities)),
        *(f"identity_spread_{s + 1}" for s in range(identities)),
        "person",
        "adjusted_frames",
        "adjustment_rms_px",
        "score",
        *(f"{WEIGHT}{name}" for name in POINT_NAMES),
    )


@dataclass(frozen=True, eq=False)
class MonoNumbers:
    """The further numbers of one frame; what is not known is NaN.

    Attributes:
        identity: (S,) s, the mean of the last adjustments, (4.36).
        spread: (S,) standard deviation of s over them.
        person: how many other people were seen before this one.
        adjusted_frames: how many frames this person was adjusted from.
        rms_px: root mean square distance of the points from the adjusted face, pixels.
        score: mean correlation of the visible points, -1 to 1.
        weights: (K,) how much each point counted, 0 (hidden, turned away or unlike) to 1.
    """

    identity: FloatArray
    spread: FloatArray
    person: int = 0
    adjusted_frames: int = 0
    rms_px: float = np.nan
    score: float = np.nan
    weights: FloatArray | None = None

    def array(self) -> FloatArray:
        """Return the (M,) numbers, in the order of ``mono_number_names``."""
        weights = np.full(POINT_COUNT, np.nan) if self.weights is None else self.weights
        single = (float(self.person), float(self.adjusted_frames), self.rms_px, self.score)
        return np.concatenate([self.identity, self.spread, single, weights])
