"""One hand as the tracker knows it: its bones and its skin. This is the one place that makes hands."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import UsageError
from posetrack_cli.hand.anatomy import ANGLE_NAMES, POSE_SIZE, HandAnatomy, make_anatomy
from posetrack_cli.hand.config import HandSettings
from posetrack_cli.hand.forearm import with_forearm
from posetrack_cli.hand.kinematics import skinning_transforms
from posetrack_cli.hand.mesh import hand_mesh
from posetrack_cli.hand.shape import HandShape
from posetrack_cli.rendering.decimation import Decimation, decimation
from posetrack_cli.rendering.mesh import SkinnedMesh

LEAN_TRIANGLES = 410
_LEAN_ARM, _SMOOTH_ARM = (10, 5), (16, 7)
# flexion of joint 3 and 2, rad: open, half closed, a fist, hooked, and bent at the knuckles alone
_BENDS = ((0.0, 0.0), (0.8, 0.9), (1.4, 1.6), (0.2, 1.3), (1.3, 0.2))
_THUMB_SHARE = 0.5  # of the fingers' bends in the thumb's


def lean_mesh(anatomy: HandAnatomy, smooth: SkinnedMesh | None = None) -> SkinnedMesh:
    """Return the skin of an average hand in any shape with ``LEAN_TRIANGLES`` triangles.

    All hands have the same triangles and weights, and vertices that are linear in those of the smooth skin.

    Args:
        anatomy: of ``make_anatomy``.
        smooth: its ``medium`` mesh, where that is at hand.
    """
    smooth = smooth or hand_mesh(anatomy, "medium")
    mesh = _average_decimation().of(smooth.vertices)
    return (
        SkinnedMesh(mesh.vertices, mesh.weights, mesh.triangles[:, ::-1].copy()) if anatomy.is_left else mesh
    )


def bent_hands(anatomy: HandAnatomy) -> FloatArray:
    """Bone transforms (K, B, 3, 4) of open to closed hands: the poses in which a simpler skin has to fit."""
    poses = np.zeros((len(_BENDS), POSE_SIZE))
    poses[:, 6] = 1.0
    for pose, (first, second) in zip(poses, _BENDS, strict=True):
        for k, name in enumerate(ANGLE_NAMES):
            if name.endswith("flexion"):
                share = _THUMB_SHARE if name.startswith("thumb") else 1.0
                pose[POSE_SIZE - len(ANGLE_NAMES) + k] = share * (first if _is_first(name) else second)
    return np.asarray(skinning_transforms(anatomy, poses), dtype=np.float64)


def _is_first(name: str) -> bool:
    return "cmc" in name or ("mcp" in name and not name.startswith("thumb"))


@functools.cache
def _average_decimation() -> Decimation:
    """How the lean skin follows the smooth one, found once for the average right hand."""
    average = make_anatomy()
    return decimation(hand_mesh(average, "medium"), LEAN_TRIANGLES, bent_hands(average))


MESH_DIGEST = "hand.mesh_sha256"
"""Key of a run's record that tells a file's hand from any other."""
SMOOTH_TRIANGLES = 1640
"""What is drawn of a hand from a file: as many as the average hand has."""
_MOST_TRIANGLES = 2 * SMOOTH_TRIANGLES
"""What is left of a skin whose parts cannot be joined; what follows takes the square of it."""

HandMaker = Callable[[str, HandShape], "HandModel"]
"""Makes a hand of a side (``right`` or ``left``) and a shape."""


@dataclass(frozen=True, eq=False)
class HandModel:
    """Bones and skin of one hand, in hand coordinates at zero angles, mm.

    Attributes:
        anatomy: joints, segments, radii, side.
        lean: few triangles: what many poses are drawn with at once.
        smooth: more triangles, on the skin itself: what a pose is fitted and shown with.
        whole: makes the skin with all the triangles that there are: what pictures are drawn with;
            None where the smooth one has them all.
    """

    anatomy: HandAnatomy
    lean: SkinnedMesh
    smooth: SkinnedMesh
    whole: Callable[[], SkinnedMesh] | None = None

    @cached_property
    def lean_with_arm(self) -> SkinnedMesh:
        """The lean skin with a forearm's: what many poses are drawn with where arms are explained."""
        return with_forearm(self.lean, self.smooth, self.anatomy, *_LEAN_ARM)

    @cached_property
    def smooth_with_arm(self) -> SkinnedMesh:
        """The smooth skin with a forearm's."""
        return with_forearm(self.smooth, self.smooth, self.anatomy, *_SMOOTH_ARM)

    def skin(self, level: str) -> SkinnedMesh:
        """The skin of a level: ``lean``, ``medium`` (the smooth one) or ``fine`` (the whole)."""
        if level == "fine" and self.whole is not None:
            return self.whole()
        return self.lean if level == "lean" else self.smooth


def hand_model(settings: HandSettings) -> HandModel:
    """Return the hand that a configuration's ``[hand]`` table describes; one of open side as a right one.

    Raises:
        UsageError: ``settings.mesh`` is no hand that can be used.
    """
    side = "right" if settings.side == "auto" else settings.side
    return hand_maker(settings.mesh)(side, settings.shape)


def hand_maker(mesh: str | None) -> HandMaker:
    """Return what makes hands of any side and shape: from the average hand, or from that of a GLB file."""
    return average_hand if mesh is None else _file_hand(Path(mesh))


def average_hand(side: str = "right", shape: HandShape | None = None) -> HandModel:
    """Return the average adult hand in a shape."""
    shape = shape or HandShape()
    anatomy = make_anatomy(
        side,
        shape.scale,
        shape.finger_lengths,
        shape.finger_widths,
        shape.palm,
        shape.wrist_width,
        shape.thumb_place,
        shape.coefficients,
    )
    smooth = hand_mesh(anatomy, "medium").grown(shape.padding_mm)

    def whole() -> SkinnedMesh:
        return hand_mesh(anatomy, "fine").grown(shape.padding_mm)

    return HandModel(anatomy, lean_mesh(anatomy, smooth), smooth, whole)


def _file_hand(path: Path) -> HandMaker:
    from posetrack_cli.hand.shape import reshaped_anatomy, reshaped_skin
    from posetrack_cli.hand.webxr import load_hand
    from posetrack_cli.rendering.decimation import decimated
    from posetrack_cli.rendering.gltf import damage_named
    from posetrack_cli.rendering.simplify import simplified

    hand = load_hand(path)
    with damage_named(path), np.errstate(all="ignore"):  # triangles without area divide by nothing
        smooth = simplified(hand.skin, SMOOTH_TRIANGLES)
        if max(len(smooth.triangles), len(smooth.vertices)) > _MOST_TRIANGLES:
            what = "skin falls into too many parts to be simplified"
            raise UsageError(what, where=path, found=f"{len(smooth.triangles)} triangles left")
        lean = decimated(smooth, LEAN_TRIANGLES, bent_hands(hand.anatomy))
    if not (np.isfinite(smooth.vertices).all() and np.isfinite(lean.vertices).all()):
        raise UsageError("skin cannot be simplified", where=path, found="vertices that are no numbers")

    def make(side: str, shape: HandShape) -> HandModel:
        def skin(mesh: SkinnedMesh) -> SkinnedMesh:
            return reshaped_skin(mesh, hand.anatomy, side, shape).grown(shape.padding_mm)

        anatomy = reshaped_anatomy(hand.anatomy, side, shape)
        return HandModel(anatomy, skin(lean), skin(smooth), partial(skin, hand.skin))

    return make
