"""One hand as the tracker knows it: its bones and its skin."""

from __future__ import annotations

from dataclasses import dataclass

from posetrack_cli.hand.anatomy import HandAnatomy, make_anatomy
from posetrack_cli.hand.config import HandSettings
from posetrack_cli.hand.mesh import hand_mesh
from posetrack_cli.rendering.mesh import SkinnedMesh


@dataclass(frozen=True, eq=False)
class HandModel:
    """Bones and skin of one hand, in hand coordinates at zero angles, mm.

    Attributes:
        anatomy: joints, segments, radii, side.
        lean: few triangles: what many poses are drawn with at once.
        smooth: more triangles, on the skin itself: what a pose is fitted and shown with.
    """

    anatomy: HandAnatomy
    lean: SkinnedMesh
    smooth: SkinnedMesh


def hand_model(settings: HandSettings) -> HandModel:
    """Return the hand that a configuration's ``[hand]`` table describes."""
    anatomy = make_anatomy(settings.side, settings.scale, settings.finger_lengths)
    return HandModel(anatomy, hand_mesh(anatomy, "lean"), hand_mesh(anatomy, "medium"))
