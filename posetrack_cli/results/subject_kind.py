"""What formats, exports and measurements must know of a kind of subject beyond the names of its parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.euler import EULER_ORDER, head_roll_pitch_yaw, roll_pitch_yaw
from posetrack_cli.recording.pixels import PixelKind


@dataclass(frozen=True)
class SubjectKind:
    """A kind of subject; the defaults hold for every name that has no kind of its own.

    Attributes:
        shape_unit: of the shape entries, ``rad`` of angles; empty for coefficients.
        euler_angles: makes roll, pitch, yaw (N, 3), rad, from quaternions (N, 4).
        euler_order: what these angles mean, for the headers of files.
        rigid: whether its points hardly move in its own axes: tables have them there, and pictures of its
            pose need axes.
        pixels: of the images that it is tracked in.
    """

    shape_unit: str = "rad"
    euler_angles: Callable[[FloatArray], FloatArray] = roll_pitch_yaw
    euler_order: str = EULER_ORDER
    rigid: bool = False
    pixels: PixelKind = "depth"


_HEAD = SubjectKind(
    shape_unit="",
    euler_angles=head_roll_pitch_yaw,
    euler_order=(
        f"{EULER_ORDER}; all 0 for a head that looks at the camera (half a turn about x is taken off), "
        "positive where it tilts to its own left shoulder, lowers its face, turns to its own right"
    ),
    rigid=True,
    pixels="grey",
)
_KINDS = {"head": _HEAD}
_ANY = SubjectKind()


def kind_of(subject: str) -> SubjectKind:
    """Return the kind of a subject of this name."""
    return _KINDS.get(subject, _ANY)
