"""The head as a subject of results, its motion model and its diagnostics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.actions import ACTION_NAMES, action_numbers
from posetrack_cli.head.dense.numbers import FACE_NUMBERS
from posetrack_cli.head.face.points import BROWS, LINES, POINT_COUNT, POINT_NAMES, of_kinds
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.results.estimate import Subject
from posetrack_cli.tracking.confidence import SIGN
from posetrack_cli.tracking.velocity import VelocityModel

if TYPE_CHECKING:
    from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig

# Motion and systematic errors of tracked heads, for each tracker **[ours]**


@dataclass(frozen=True, eq=False)
class TrackModel:
    """Motion model and systematic errors of a tracker.

    Attributes:
        systematic_sd: (6,) standard deviations of errors common to all frames of a track, which the particles
            cannot show: mm in camera axes and rad about the head's axes. They come from the assumed places of
            the person's points in the head, and are part of the variances in results.
        velocity: motion model of the six pose components, for the velocity in results.
        deformation: for smoothing, scale of the standard deviations of the deformation; 0 disables it.
        expression_mm: (K,) for smoothing, additional motion of each point in expressions.
        pitch_per_brow: rad per mm, standard deviation of the pitch that raised or lowered brows cause.
    """

    systematic_sd: FloatArray
    velocity: VelocityModel
    deformation: float
    expression_mm: FloatArray
    pitch_per_brow: float

    def expression_variance(self, moved: FloatArray) -> FloatArray:
        """Return the (6,) variances of the pose error from an expression, as ``systematic_sd`` squared.

        Args:
            moved: (K, 3) displacements from the neutral face, mm in head axes.
        """
        variance = np.zeros(6)
        variance[3] = (self.pitch_per_brow * moved[BROWS, 1].mean()) ** 2
        return variance


def _six(position: float, rotation: float) -> FloatArray:
    return np.repeat([position, rotation], 3)


START_SD = _six(200.0, 2.0)
"""Standard deviations of a head's velocity at the start of a track, mm/s and rad/s."""

STEREO_TRACK = TrackModel(
    # RMS errors over twelve rendered people
    systematic_sd=np.concatenate([[2.6, 2.3, 3.3], np.radians([2.3, 1.8, 1.4])]),
    velocity=VelocityModel(_six(40.0, 0.5), _six(0.1, 0.001), START_SD),
    # the cameras measure points directly, and the deformations are learned from few frames
    deformation=0.0,
    expression_mm=of_kinds(eyes=0.3, mouth=5.0, nostrils=1.0, brows=2.0),
    pitch_per_brow=np.radians(0.3),
)
MONO_TRACK = TrackModel(
    # tuned on twelve people, leaving out each person from the training of the appearance model
    systematic_sd=np.concatenate([[1.0, 1.0, 3.0], np.radians([1.7, 1.1, 0.45])]),
    velocity=VelocityModel(_six(90.0, 0.8), _six(0.3, 0.003), START_SD),
    deformation=1.0,
    expression_mm=of_kinds(eyes=0.5, mouth=1.2, nostrils=0.9, brows=1.5),
    pitch_per_brow=np.radians(0.8),
)


def track_model(config: HeadStereoConfig | HeadMonoConfig) -> TrackModel:
    """Return the track model for a configuration."""
    from posetrack_cli.head.config import HeadMonoConfig  # which takes 60 ms, and evaluation needs none

    return MONO_TRACK if isinstance(config, HeadMonoConfig) else STEREO_TRACK


# Contents of a head result besides the pose.
#
# ``Estimate.points``: refined points in camera axes; M' with several cameras, m^ at the depths of the
# adjusted face with one. They are exported in the head's own axes, as its shape.
# ``Estimate.shape``: deformation; with several cameras the B coefficients a of the learned model, mm along
# orthonormal directions (3.1), with one camera the A' parameters a of (4.15), without unit.
# ``Estimate.numbers``: progress of the learned model, or the identity s and its spread over recent
# adjustments, followed by facial actions (``head.actions``) and confidence signs.


HEAD = "head"
OUTER_EYES = ("right_eye_outer", "left_eye_outer")
RIGHT_DEG, RIGHT_MM = 3.0, 5.0
"""Error limits of a correct frame: rotation, and mean distance of the points in head coordinates."""
COLOUR = (0.3, 0.85, 0.95, 1.0)
WEIGHT = "weight_"
SKIN_SHARE = "skin_share"
"""Name of the number that states how much of the pose comes from the skin, one camera only."""
SIGNS = ("misfit", "smallness", "unsteadiness", "unseen", "unmatched")
"""Inputs of the confidence model, in the order of ``head.tracker.frame_tracker``."""
SIGN_NAMES = tuple(f"{SIGN}{name}" for name in SIGNS)


def head_subject(camera_frame: str, components: int, numbers: tuple[str, ...] | None = None) -> Subject:
    """Return the subject of a head with B deformation components.

    Args:
        camera_frame: reference frame of the pose.
        components: B; 0 for a rigid face.
        numbers: names of the diagnostics, by default those of the stereo tracker. The signs are appended.
    """
    return Subject(
        HEAD,
        camera_frame,
        shape_names=tuple(f"deformation_{b + 1}" for b in range(components)),
        point_names=POINT_NAMES,
        point_parents=(-1,) * POINT_COUNT,
        colour=COLOUR,
        lines=LINES,
        number_names=(*(stereo_diagnostic_names(components) if numbers is None else numbers), *SIGN_NAMES),
    )


def with_dense_face(subject: Subject) -> Subject:
    """Return the subject of a head whose dense face is measured as well.

    Its numbers follow those of the head. Actions estimated from the ten points are left out.
    """
    return replace(
        subject,
        number_names=(*(name for name in subject.number_names if name not in ACTION_NAMES), *FACE_NUMBERS),
    )


def stereo_diagnostic_names(components: int) -> tuple[str, ...]:
    """Return the M = B + 3 + K + 2 E names, in the order of ``StereoDiagnostics.numbers``."""
    return (
        *(f"eigenvalue_{b + 1}_mm2" for b in range(components)),
        "contribution_ratio",
        "learnt_frames",
        "score",
        *(f"{WEIGHT}{name}" for name in POINT_NAMES),
        *ACTION_NAMES,
    )


@dataclass(frozen=True, eq=False)
class StereoDiagnostics:
    """Diagnostics of one frame with several cameras; unknown values are NaN.

    Attributes:
        eigenvalues: (up to B,) of the model learned so far, mm^2, descending.
        contribution_ratio: share of the sample variance in the B components, 0 to 1 (figure 3.10).
        learnt_frames: number of frames that trained the model.
        score: mean correlation of the visible points, -1 to 1.
        weights: (K,) weight of each point, 0 (hidden, turned away or unlike) to 1.
        moved: (K, 3) mm, displacements from the neutral face, from which the actions are estimated.
    """

    eigenvalues: FloatArray
    contribution_ratio: float = np.nan
    learnt_frames: int = 0
    score: float = np.nan
    weights: FloatArray | None = None
    moved: FloatArray | None = None

    def numbers(self, components: int) -> FloatArray:
        """Return the (M,) numbers for B components, in the order of ``stereo_diagnostic_names``."""
        eigenvalues = np.full(components, np.nan)
        eigenvalues[: len(self.eigenvalues)] = self.eigenvalues[:components]
        weights = np.full(POINT_COUNT, np.nan) if self.weights is None else self.weights
        single = (self.contribution_ratio, float(self.learnt_frames), self.score)
        return np.concatenate([eigenvalues, single, weights, action_numbers(self.moved)])


def mono_subject(camera_frame: str, model: FaceModel) -> Subject:
    """Return the subject of a head tracked with one camera."""
    return head_subject(camera_frame, model.deformation_size, mono_diagnostic_names(model.identity_size))


def mono_diagnostic_names(identities: int) -> tuple[str, ...]:
    """Return the M = 2 S' + 7 + K + 2 E names, in the order of ``MonoDiagnostics.numbers``."""
    return (
        *(f"identity_{s + 1}" for s in range(identities)),
        *(f"identity_spread_{s + 1}" for s in range(identities)),
        "person",
        "size",
        "size_sd",
        "adjusted_frames",
        "adjustment_rms_px",
        SKIN_SHARE,
        "score",
        *(f"{WEIGHT}{name}" for name in POINT_NAMES),
        *ACTION_NAMES,
    )


@dataclass(frozen=True, eq=False)
class MonoDiagnostics:
    """Diagnostics of one frame with one camera; unknown values are NaN.

    Attributes:
        identity: (S,) s, the mean of the last adjustments, (4.36).
        spread: (S,) standard deviation of s over them.
        person: index of the person in order of appearance.
        size, size_sd: scale factor of the person relative to the most likely size, 1 without a measurement,
            and the standard deviation of its logarithm.
        adjusted_frames: number of frames used to adjust this person.
        rms_px: root mean square distance of the points from the adjusted face, pixels.
        skin_share: share of the skin in the pose, 0 to 1.
        score: mean correlation of the visible points, -1 to 1.
        weights: (K,) weight of each point, 0 (hidden, turned away or unlike) to 1.
        moved: (K, 3) mm, displacements from the neutral face, from which the actions are estimated.
    """

    identity: FloatArray
    spread: FloatArray
    person: int = 0
    size: float = np.nan
    size_sd: float = np.nan
    adjusted_frames: int = 0
    rms_px: float = np.nan
    skin_share: float = np.nan
    score: float = np.nan
    weights: FloatArray | None = None
    moved: FloatArray | None = None

    def numbers(self) -> FloatArray:
        """Return the (M,) numbers, in the order of ``mono_diagnostic_names``."""
        weights = np.full(POINT_COUNT, np.nan) if self.weights is None else self.weights
        single = (
            float(self.person),
            self.size,
            self.size_sd,
            float(self.adjusted_frames),
            self.rms_px,
            self.skin_share,
            self.score,
        )
        return np.concatenate([self.identity, self.spread, single, weights, action_numbers(self.moved)])
