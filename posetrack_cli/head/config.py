"""The head trackers' configuration; ``configs/head-stereo.toml`` states these defaults with their reasons."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from posetrack_cli.configuration import Settings

# Wider than any head, camera or time, and narrow enough that no arithmetic on them overflows.
Positive = Annotated[float, Field(ge=1e-6, le=1e6)]
NotNegative = Annotated[float, Field(ge=0.0, le=1e6)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]


class ModelSettings(Settings):
    """How the face may deform, and how its model is learnt while tracking (thesis, 3.2.4).

    ``components`` is B. The first ``rigid_frames`` frames are tracked with a rigid face, whose mean shape
    moves towards what is measured at ``mean_rate`` a frame **[ours]**. A frame is learnt from where the face
    is turned from the camera by less than ``facing_deg``, the shape differs from the mean by ``least_mm`` to
    ``most_mm`` (the length of its 3K numbers) and every point correlates above ``correlation``.
    """

    kind: Literal["deformable", "rigid"] = "deformable"
    components: Annotated[int, Field(ge=1, le=20)] = 5
    rigid_frames: Annotated[int, Field(ge=0)] = 120
    mean_rate: Fraction = 0.1
    facing_deg: Positive = 25.0
    least_mm: NotNegative = 3.0
    most_mm: Positive = 40.0
    correlation: Fraction = 0.5


class HeadStatusSettings(Settings):
    """When a head counts as tracked **[ours]**.

    A frame's score is the mean correlation of its visible points. Below ``tracking_above`` a frame is lost;
    after ``lost_after_frames`` of them the face is searched for again.
    """

    tracking_above: Fraction = 0.6
    lost_after_frames: Count = 3


class HeadOutputSettings(Settings):
    """How a result is written."""

    flush_frames: Count = 30


class HeadStereoConfig(Settings):
    """Everything that a stereo run depends on besides its recording and its seed."""

    model: ModelSettings = ModelSettings()
    status: HeadStatusSettings = HeadStatusSettings()
    output: HeadOutputSettings = HeadOutputSettings()
