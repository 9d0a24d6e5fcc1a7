"""The head as a subject of results, and how heads move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.actions import ACTION_NAMES, action_numbers
from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig
from posetrack_cli.head.face.points import LINES, POINT_COUNT, POINT_NAMES, of_kinds
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.results.estimate import Subject
from posetrack_cli.tracking.confidence import SIGN
from posetrack_cli.tracking.velocity import VelocityModel

# How heads move, and what tracks of them are wrong by, for each tracker **[ours]**


@dataclass(frozen=True, eq=False)
class TrackModel:
    """What one of the trackers is known to do.

    Attributes:
        systematic_sd: (6,) what a whole track is wrong by, alike in all frames, so that no particle tells: mm
            in camera axes and rad about the head's axes. It comes from where a person's points are taken to
            be in the head, and is part of the variances that a result states.
        velocity: of the six entries of a head's pose, for the velocity that a result states.
        deformation: for smoothing, how many of their standard deviations the deformations explain; 0 is none.
        expression_mm: (K,) for smoothing, how far expressions move points in addition to that.
    """

    systematic_sd: FloatArray
    velocity: VelocityModel
    deformation: float
    expression_mm: FloatArray


def _six(position: float, rotation: float) -> FloatArray:
    return np.repeat([position, rotation], 3)


START_SD = _six(200.0, 2.0)
"""Of a head's velocity where a track begins, mm/s and rad/s: as of a hand's."""

STEREO_TRACK = TrackModel(
    # root mean squares over twelve rendered people
    systematic_sd=np.concatenate([[2.6, 2.3, 3.3], np.radians([2.3, 1.8, 1.4])]),
    velocity=VelocityModel(_six(40.0, 0.5), _six(0.1, 0.001), START_SD),
    # several cameras measure points, and learn deformations from few frames
    deformation=0.0,
    expression_mm=of_kinds(eyes=0.3, mouth=5.0, nostrils=1.0, brows=2.0),
)
MONO_TRACK = TrackModel(
    # chosen on twelve people, ten of whom were tracked with what was learned from the others
    systematic_sd=np.concatenate([[1.0, 1.0, 3.0], np.radians([1.7, 1.1, 0.45])]),
    velocity=VelocityModel(_six(90.0, 0.8), _six(0.3, 0.003), START_SD),
    deformation=1.0,
    expression_mm=of_kinds(eyes=0.5, mouth=1.2, nostrils=0.9, brows=1.5),
)


def track_model(config: HeadStereoConfig | HeadMonoConfig) -> TrackModel:
    """Return that of the tracker which a configuration is for."""
    return MONO_TRACK if isinstance(config, HeadMonoConfig) else STEREO_TRACK


# What a head's result holds beside its pose: names of points, deformation coefficients and diagnostics.
#
# ``Estimate.points`` are the recalculated points, in camera axes: M' of several cameras, m^ at the depths of
# the adjusted face of one. In the head's own axes they are the 3K numbers of its shape, which is how they are
# exported. ``Estimate.shape`` holds the deformation: of several cameras the B coefficients a of the learnt
# model, mm along orthonormal directions (3.1), of one camera the A' parameters a of (4.15), without unit.
# ``Estimate.numbers`` tell how far the model has been learnt, or who the person is taken for: the identity
# parameters s, and how far they moved over the last adjustments; and what the face does (``head.actions``).


HEAD = "head"
RIGHT_DEG, RIGHT_MM = 3.0, 5.0
"""Largest rotation error and mean error of the points, in head coordinates, of a frame that is right."""
COLOUR = (0.3, 0.85, 0.95, 1.0)
WEIGHT = "weight_"
SKIN_SHARE = "skin_share"
"""Of the numbers of a head that one camera sees, how far its pose is that of its skin."""
SIGNS = ("misfit", "smallness", "unsteadiness", "unseen", "unmatched")
"""Of what confidence is made, in the order of ``head.tracker.frame_tracker``."""
SIGN_NAMES = tuple(f"{SIGN}{name}" for name in SIGNS)


def head_subject(camera_frame: str, components: int, numbers: tuple[str, ...] | None = None) -> Subject:
    """Return the subject of a head whose face deforms in so many components (B; 0 of a rigid one).

    Args:
        camera_frame: that its pose is relative to.
        components: B.
        numbers: names of the diagnostics; those of the stereo tracker without. The signs follow them.
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


def stereo_diagnostic_names(components: int) -> tuple[str, ...]:
    """Return the names of the M = B + 3 + K + 2 E numbers, in the order of ``StereoDiagnostics.numbers``."""
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
    """The further numbers of one frame; what is not known is NaN.

    Attributes:
        eigenvalues: (up to B,) of the model learnt so far, mm^2, descending.
        contribution_ratio: share of the variance of the samples that the B components hold, 0 to 1 (figure
            3.10).
        learnt_frames: how many frames the model was learnt from.
        score: mean correlation of the visible points, -1 to 1.
        weights: (K,) how much each point counted, 0 (hidden, turned away or unlike) to 1.
        moved: (K, 3) mm, the points' displacements from the neutral face, which tell its actions.
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
    """Return the subject of a head that one camera sees."""
    return head_subject(camera_frame, model.deformation_size, mono_diagnostic_names(model.identity_size))


def mono_diagnostic_names(identities: int) -> tuple[str, ...]:
    """Return the names of the M = 2 S' + 7 + K + 2 E numbers, in the order of ``MonoDiagnostics.numbers``."""
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
    """The further numbers of one frame; what is not known is NaN.

    Attributes:
        identity: (S,) s, the mean of the last adjustments, (4.36).
        spread: (S,) standard deviation of s over them.
        person: how many other people were seen before this one.
        size, size_sd: what the lengths of the likeliest such person are multiplied by, 1 where nothing tells,
            and the standard deviation of its logarithm.
        adjusted_frames: how many frames this person was adjusted from.
        rms_px: root mean square distance of the points from the adjusted face, pixels.
        skin_share: how far the pose is the skin's, 0 to 1.
        score: mean correlation of the visible points, -1 to 1.
        weights: (K,) how much each point counted, 0 (hidden, turned away or unlike) to 1.
        moved: (K, 3) mm, the points' displacements from the neutral face, which tell its actions.
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
