"""Estimates of a frame, and the tracked subjects."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import ResultError
from posetrack_cli.geometry.rotations import EULER_ORDER, head_roll_pitch_yaw, roll_pitch_yaw
from posetrack_cli.recording.pixels import PixelKind

MOST_SUBJECTS = 64
"""Largest number of subjects of a result."""
_LABEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}", re.ASCII)

# Properties of a kind of subject that formats, exports and measurements depend on


@dataclass(frozen=True)
class SubjectKind:
    """Kind of subject; the defaults apply to every name without a kind of its own.

    Attributes:
        shape_unit: unit of the shape parameters: ``rad`` for angles, empty for coefficients.
        euler_angles: function returning roll, pitch, yaw (N, 3), rad, of quaternions (N, 4).
        euler_order: definition of these angles, for file headers.
        rigid: whether its points hardly move in its own axes. Tables then list them in these axes, and
            drawings show the axes.
        pixels: kind of images it is tracked in.
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
    """Return the kind of the subject with this name."""
    return _KINDS.get(subject, _ANY)


# Estimates and subjects


class Status(StrEnum):
    """Tracking status of a frame."""

    TRACKING = "tracking"
    LOST = "lost"
    REINITIALISED = "reinitialised"


@dataclass(frozen=True, eq=False)
class Estimate:
    """State of one subject at one frame.

    K is the number of shape parameters, P the number of points. The tangent space is
    (position, mm, camera axes; rotation vector, rad, body frame; shape), 6 + K entries.

    Attributes:
        frame_index: position of the frame in the recording.
        stamp_ns: time of the frame, integer nanoseconds.
        status: tracking status; says whether this frame's image supports the estimate.
        confidence: 0 (guess) to 1 (certain).
        position: (3,) mm, origin of the object in camera axes.
        quaternion: (4,) x y z w with w >= 0, rotation of ``camera_T_object``.
        shape: (K,) finger angles of a hand, rad, or shape coefficients of a head.
        pose_rate: (7 + K,) time derivative of (position, quaternion, shape), per second.
        twist: (6 + K,) velocity in the tangent space: mm/s, rad/s, shape per second.
        pose_variance: (6 + K,) diagonal of the pose covariance in the tangent space; None if the tracker
            has none, such as an optimiser.
        twist_variance: (6 + K,) diagonal of the covariance of ``twist``. ``pose_rate``, ``twist`` and
            ``twist_variance`` are all None if the velocity is unknown or undefined, e.g. ground truth of a
            random walk.
        points: (P, 3) mm, joints or landmarks in camera axes.
        effective_sample_size: of the particle weights before resampling; None without weights.
        resampled: whether the particles were resampled after this estimate.
        cost: cost of the estimate against the image; None if not evaluated.
        milliseconds: processing time of the frame. None unless timings were requested, as wall-clock times
            make equal runs differ in their bytes.
        evaluations: number of poses scored against the image for this estimate; None if not counted.
        numbers: (M,) additional numbers named by ``Subject.number_names``, NaN where unknown; None if there
            are none.
    """

    frame_index: int
    stamp_ns: int
    status: Status
    confidence: float
    position: FloatArray
    quaternion: FloatArray
    shape: FloatArray
    pose_rate: FloatArray | None
    twist: FloatArray | None
    pose_variance: FloatArray | None
    twist_variance: FloatArray | None
    points: FloatArray
    effective_sample_size: float | None
    resampled: bool
    cost: float | None = None
    milliseconds: float | None = None
    evaluations: int | None = None
    numbers: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Subject:
    """Tracked subject.

    Attributes:
        name: kind of the subject, such as ``hand``.
        camera_frame: frame id of the camera that estimates are relative to.
        shape_names: K names of the entries of ``Estimate.shape``.
        point_names: P names of the rows of ``Estimate.points``.
        point_parents: P indices of each point's parent, -1 for a root; parents precede their children.
        triangles: (T, 3) vertex indices of the mesh; None for no mesh.
        colour: colour of mesh and lines, (red, green, blue, alpha), each 0 to 1.
        lines: pairs of points drawn as lines in 3D and on the images.
        number_names: M names of the entries of ``Estimate.numbers``, including units.
        label: distinguishes the subjects of one result, such as ``left`` or ``1``; empty for an only one.

    Raises:
        ResultError: names, parents, triangles or lines are inconsistent.
    """

    name: str
    camera_frame: str
    shape_names: tuple[str, ...]
    point_names: tuple[str, ...]
    point_parents: tuple[int, ...]
    triangles: IntArray | None = None
    colour: tuple[float, float, float, float] = (0.85, 0.65, 0.52, 1.0)
    lines: tuple[tuple[int, int], ...] = ()
    number_names: tuple[str, ...] = ()
    label: str = ""

    @property
    def topic(self) -> str:
        """Part of the topics' names: ``hand``, ``hand/left``."""
        return f"{self.name}/{self.label}" if self.label else self.name

    @property
    def frame(self) -> str:
        """Frame id of the body: ``hand``, ``hand_left``."""
        return f"{self.name}_{self.label}" if self.label else self.name

    def __post_init__(self) -> None:
        if not self.name or "/" in self.name:
            raise ResultError(
                "invalid subject name", found=repr(self.name), expected="a name without slashes"
            )
        if self.label and not _LABEL.fullmatch(self.label):
            raise ResultError(
                "invalid subject label", found=repr(self.label), expected="letters, digits, - and _"
            )
        if len(self.point_parents) != len(self.point_names):
            raise ResultError(
                "numbers of points and parents differ",
                where=self.name,
                found=f"{len(self.point_names)} names and {len(self.point_parents)} parents",
            )
        for index, parent in enumerate(self.point_parents):
            if not -1 <= parent < index:
                raise ResultError(
                    f"invalid parent of point {self.point_names[index]}",
                    where=self.name,
                    found=parent,
                    expected=f"-1 to {index - 1}",
                )
        if self.triangles is not None and (self.triangles.ndim != 2 or self.triangles.shape[1] != 3):
            raise ResultError(
                "invalid triangles", where=self.name, found=self.triangles.shape, expected="(T, 3)"
            )
        self._check_lines()

    def _check_lines(self) -> None:
        count = len(self.point_names)
        for line in self.lines:
            if len(line) != 2 or not all(0 <= end < count for end in line):
                expected = f"two of the points 0 to {count - 1}"
                raise ResultError("invalid line", where=self.name, found=line, expected=expected)
