"""Whether the points that a run saw contradict the camera's focal length."""

from __future__ import annotations

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.adjustment.intrinsics import check_focal
from posetrack_cli.head.mono_config import AdjustmentSettings
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.person import KnownPerson

VIEWS = 40
"""So many views of different directions can tell that a focal length is wrong; fewer are not asked."""


def focal_doubt(
    person: KnownPerson, model: FaceModel, camera: Camera, scale: float, settings: AdjustmentSettings
) -> tuple[str, ...]:
    """Return a line that says that another focal length fits better, nothing where that is not clear.

    Args:
        person: with an album of views.
        model: of faces.
        camera: that saw them, on images reduced by ``scale``.
        scale: of them.
        settings: of the adjustment.
    """
    views = person.album.some(VIEWS)
    if settings.when != "always" or len(views) < VIEWS:
        return ()
    check = check_focal(views, person.person, model, camera, settings)
    if not check.beyond_doubt:
        return ()
    focal = camera.fx / scale
    return (
        f"focal length {focal:.0f} px, but the points fit {check.factor * focal:.0f} px better: are the "
        "intrinsics right? z and scale depend on them",
    )
