"""Estimates of a frame, and the kinds of subjects that they are of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import ResultError
from posetrack_cli.geometry.rotations import EULER_ORDER, head_roll_pitch_yaw, roll_pitch_yaw
from posetrack_cli.recording.pixels import PixelKind

# What formats, exports and measurements must know of a kind of subject beyond the names of its parts


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


# What a tracker says about one frame, and what it tracks


class Status(StrEnum):
    """What a frame's estimate rests on."""

    TRACKING = "tracking"
    LOST = "lost"
    REINITIALISED = "reinitialised"


@dataclass(frozen=True, eq=False)
class Estimate:
    """The state of one subject at one frame.

    K is the number of shape entries, P the number of points. The tangent space is
    (position, mm, camera axes; rotation vector, rad, body frame; shape), 6 + K entries.

    Attributes:
        frame_index: position of the frame in the recording.
        stamp_ns: when the frame was taken, integer nanoseconds.
        status: whether the estimate rests on this frame's image.
        confidence: 0 (guess) to 1 (certain).
        position: (3,) mm, origin of the object in camera axes.
        quaternion: (4,) x y z w with w >= 0, rotation of ``camera_T_object``.
        shape: (K,) of a hand the finger angles, rad; of a head the shape coefficients.
        pose_rate: (7 + K,) time derivative of (position, quaternion, shape), per second.
        twist: (6 + K,) velocity in the tangent space: mm/s, rad/s, shape per second.
        pose_variance: (6 + K,) diagonal of the covariance of the pose in the tangent space; None of a tracker
            that knows none, such as an optimiser.
        twist_variance: (6 + K,) diagonal of the covariance of ``twist``. This, ``pose_rate`` and ``twist``
            are all None where no velocity is known, or the motion has none: the truth of a random walk.
        points: (P, 3) mm, joints or landmarks in camera axes.
        effective_sample_size: of the particle weights before resampling; None without weights.
        resampled: whether the particles were resampled after this estimate.
        cost: of the estimate against the image; None when it was not evaluated.
        milliseconds: the frame took; None unless the run was asked to record timings, since wall-clock
            times make two runs differ in their bytes.
        evaluations: number of poses whose fit to the image was evaluated for this estimate; None where the
            tracker does not count them.
        numbers: (M,) further numbers, which ``Subject.number_names`` names; NaN where one is not known, None
            where there are none.
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
    """What is tracked.

    Attributes:
        name: the topic prefix and the name of the body's frame, such as ``hand``.
        camera_frame: frame id of the camera that the estimates are given in.
        shape_names: K names of the entries of ``Estimate.shape``.
        point_names: P names of the rows of ``Estimate.points``.
        point_parents: P indices of each point's parent, -1 for a root; a parent comes before its children.
        triangles: (T, 3) vertex indices of the mesh; None draws no mesh.
        colour: of mesh and lines, (red, green, blue, alpha), each 0 to 1.
        lines: pairs of points that are drawn as lines, in space and on the images; () draws neither.
        number_names: M names of the entries of ``Estimate.numbers``, units included.

    Raises:
        ResultError: names, parents, triangles or lines do not fit together.
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

    def __post_init__(self) -> None:
        if not self.name or "/" in self.name:
            raise ResultError(
                "subject's name cannot be used", found=repr(self.name), expected="no slash in it"
            )
        if len(self.point_parents) != len(self.point_names):
            raise ResultError(
                "points and parents do not fit together",
                where=self.name,
                found=f"{len(self.point_names)} names and {len(self.point_parents)} parents",
            )
        for index, parent in enumerate(self.point_parents):
            if not -1 <= parent < index:
                raise ResultError(
                    f"parent of point {self.point_names[index]} cannot be used",
                    where=self.name,
                    found=parent,
                    expected=f"-1 to {index - 1}",
                )
        if self.triangles is not None and (self.triangles.ndim != 2 or self.triangles.shape[1] != 3):
            raise ResultError(
                "triangles cannot be used", where=self.name, found=self.triangles.shape, expected="(T, 3)"
            )
        self._check_lines()

    def _check_lines(self) -> None:
        count = len(self.point_names)
        for line in self.lines:
            if len(line) != 2 or not all(0 <= end < count for end in line):
                expected = f"two of the points 0 to {count - 1}"
                raise ResultError("line cannot be drawn", where=self.name, found=line, expected=expected)
