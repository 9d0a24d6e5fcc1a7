"""Settings of face detection."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from posetrack_cli.configuration import Settings

Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


class DetectionSettings(Settings):
    """How faces are found in an image.

    ``model`` is YuNet's ONNX file. A face counts from ``least_face_score`` on (0.5 is the detector's own
    threshold), its points from a mean response of ``least_point_score`` **[ours]**; ``least_face_px`` is the
    narrowest box that the Haar cascade looks for.
    """

    file_keys: ClassVar[tuple[str, ...]] = ("model",)

    detector: Literal["haar", "yunet"] = "haar"
    model: str | None = None
    least_face_score: Fraction = 0.5
    least_point_score: Fraction = 0.3
    least_face_px: Annotated[int, Field(ge=24, le=10_000)] = 80
