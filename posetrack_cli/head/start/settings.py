"""Settings of a start."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from posetrack_cli.configuration import Settings
from posetrack_cli.head.detection.settings import DetectionSettings

Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(ge=1e-6, le=1e6)]


class StartSettings(Settings):
    """When a head counts as found **[ours]**.

    A point found in one image is matched in another if its correlation reaches ``correlation`` and it is
    found again, on the way back, within ``return_mm``; ``matched_points`` must be. Points in space must fall
    within ``reprojection_px`` of their pixels and lie like a face's: a root mean square of at most
    ``deviation`` standard deviations from an average face of ``least_size`` to ``most_size`` times its size.
    """

    detection: DetectionSettings = DetectionSettings()
    correlation: Fraction = 0.5
    return_mm: Positive = 4.0
    matched_points: Annotated[int, Field(ge=6, le=10)] = 7
    reprojection_px: Positive = 3.0
    deviation: Positive = 1.1
    least_size: Positive = 0.7
    most_size: Positive = 1.3
