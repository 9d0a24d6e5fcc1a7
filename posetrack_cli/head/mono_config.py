"""The one-camera head tracker's configuration; ``configs/head-mono.toml`` states these defaults."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from posetrack_cli.configuration import Settings
from posetrack_cli.head.config import (
    Count,
    Fraction,
    HeadOutputSettings,
    HeadStatusSettings,
    NotNegative,
    ParticleSettings,
    PointSettings,
    Positive,
    RefinementSettings,
)
from posetrack_cli.head.detection.settings import DetectionSettings

Triple = tuple[Positive, Positive, Positive]


class MonoStartSettings(Settings):
    """When a face counts as found (thesis, 4.4.1).

    It is found when it was detected in ``frames`` frames (n). A detection is rejected where the slopes of the
    K/2 segments between left and right points differ by more than ``slope_deg`` (standard deviation). The
    frames lie no more than ``span_s`` apart, so that a face seen now and then is not made one **[ours]**.
    Images in which the eyes are farther apart than ``eye_distance_px`` are reduced to it **[ours]**.
    Points count as detected with ``pixel_sd`` times the noise of tracked ones. They must lie within
    ``residual`` (root mean square, of the eyes' distance in the image) of an average face's, and once
    adjusted of the person's **[ours]**.
    """

    detection: DetectionSettings = DetectionSettings()
    frames: Annotated[int, Field(ge=1, le=30)] = 5
    slope_deg: Positive = 4.0
    span_s: Positive = 2.0
    eye_distance_px: Positive = 80.0
    pixel_sd: Positive = 2.0
    residual: Positive = 0.12


class FaceModelSettings(Settings):
    """Which multilinear model; ``file`` is what ``head build-model`` writes, none is the shipped one."""

    file_keys: ClassVar[tuple[str, ...]] = ("file",)

    file: str | None = None


class OffsetSettings(Settings):
    """Standard deviations (x, y, z) mm in the head's frame of the constant offset of each kind of point."""

    eyes: Triple = (2.0, 2.0, 2.0)
    mouth: Triple = (2.0, 2.0, 3.0)
    nostrils: Triple = (2.5, 3.0, 8.0)
    brows: Triple = (3.0, 5.0, 3.0)


class AdjustmentSettings(Settings):
    """The bundle adjustment (thesis, 4.3).

    ``when``: after every frame that faces the camera, only at the start, or never (the mean person).
    ``views`` is n; ``iterations`` of each of the two stages, ``start_iterations`` at the start. Boxes:
    ``pose_mm`` (camera x, y, z) and ``pose_rad`` (about camera x, y, z), lambda_p; ``deformation`` and
    ``identity``, lambda_a and lambda_s in standard deviations about the start, and ``bound`` standard
    deviations about the mean. The identity's start is the mean of the last ``average`` adjustments (N_s).

    **[ours]** ``prior`` weighs the squares of whitened s and a beside the boxes, ``offsets`` adds the
    constant offsets of points with the deviations ``offset_mm``, ``huber`` bounds the influence of a point
    in units of its ``pixel_sd``. A frame is adjusted with if the face is turned from the camera by less than
    ``facing_deg``, its score is above ``score``, and it is deformed by less than ``neutral_mm`` (the length
    of its 3K numbers): an expression that the model does not know would be taken for the person.
    """

    when: Literal["always", "start", "never"] = "always"
    views: Annotated[int, Field(ge=2, le=200)] = 20
    iterations: Count = 5
    start_iterations: Count = 10
    average: Count = 15
    pose_mm: Triple = (20.0, 20.0, 60.0)
    pose_rad: Triple = (0.2, 0.2, 0.1)
    deformation: Positive = 1.0
    identity: Positive = 0.5
    bound: Positive = 2.5
    prior: NotNegative = 4.0
    offsets: bool = True
    offset_mm: OffsetSettings = OffsetSettings()
    huber: Positive = 3.0
    pixel_sd: PointSettings = PointSettings(eyes=0.7, mouth=1.5, nostrils=1.2, brows=1.0)
    facing_deg: Positive = 45.0
    score: Fraction = 0.6
    neutral_mm: Positive = 6.0


class MonoStatusSettings(HeadStatusSettings):
    """When a head counts as tracked **[ours]**; see ``HeadStatusSettings``.

    A blink changes four of ten points: a frame counts with a lower score than a stereo tracker's. A score
    below ``check_below`` is compared with that of a face detected anew, every ``check_every_s`` at most.
    """

    tracking_above: Fraction = 0.45
    lost_after_frames: Count = 1
    check_below: Fraction = 0.7
    check_every_s: Positive = 0.5


class HeadMonoConfig(Settings):
    """Everything that a one-camera run depends on besides its recording and its seed."""

    file_keys: ClassVar[tuple[str, ...]] = ("start.detection.model", "model.file")

    start: MonoStartSettings = MonoStartSettings()
    model: FaceModelSettings = FaceModelSettings()
    particles: ParticleSettings = ParticleSettings(count=750, kappa=0.2, sigma=1.0)
    refinement: RefinementSettings = RefinementSettings(previous_likeness=1.0)
    adjustment: AdjustmentSettings = AdjustmentSettings()
    status: MonoStatusSettings = MonoStatusSettings()
    output: HeadOutputSettings = HeadOutputSettings()
