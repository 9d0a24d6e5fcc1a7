"""A trajectory as arrays: of a result, or of a truth from wherever it comes."""

from __future__ import annotations

from dataclasses import dataclass

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.results.estimate import Status


@dataclass(frozen=True, eq=False)
class Track:
    """A trajectory, frames (N) along the first axis of every array, stamps strictly increasing.

    What a source does not know is None: a CSV of joints has no pose, a random walk no velocity.
    K shape entries (finger angles, rad; deformation coefficients), P points (joints, landmarks).

    Attributes:
        name: what tables and errors call it.
        subject: ``hand`` or ``head``.
        shape_names: K names.
        point_names: P names.
        point_parents: P indices, -1 for a root; empty when the source does not tell.
        stamp_ns: (N,) integer nanoseconds.
        lost: (N,) frames whose status is lost; None for a truth.
        reinitialised: (N,) frames whose status is reinitialised; None for a truth.
        position: (N, 3) mm, camera axes.
        quaternion: (N, 4) x y z w, unit, w >= 0: rotation of ``camera_T_object``.
        shape: (N, K).
        twist: (N, 6 + K) mm/s in camera axes; rad/s in the body frame; shape per second.
        pose_variance: (N, 6 + K) mm^2, rad^2 (rotation vector, body frame), shape^2.
        twist_variance: (N, 6 + K) of ``twist``.
        points: (N, P, 3) mm, camera axes.
        confidence, cost, effective_sample_size, milliseconds, evaluations: (N,); NaN where unknown.
        resampled: (N,).
        frame_index: (N,) positions of the frames in the recording; None for a truth or where unknown.
    """

    name: str
    subject: str
    shape_names: tuple[str, ...]
    point_names: tuple[str, ...]
    point_parents: tuple[int, ...]
    stamp_ns: IntArray
    lost: BoolArray | None = None
    reinitialised: BoolArray | None = None
    position: FloatArray | None = None
    quaternion: FloatArray | None = None
    shape: FloatArray | None = None
    twist: FloatArray | None = None
    pose_variance: FloatArray | None = None
    twist_variance: FloatArray | None = None
    points: FloatArray | None = None
    confidence: FloatArray | None = None
    cost: FloatArray | None = None
    effective_sample_size: FloatArray | None = None
    evaluations: FloatArray | None = None
    milliseconds: FloatArray | None = None
    resampled: BoolArray | None = None
    frame_index: IntArray | None = None

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def status(self, row: int) -> Status:
        """The status of a frame; of a track that does not say, tracking."""
        if self.lost is not None and self.lost[row]:
            return Status.LOST
        if self.reinitialised is not None and self.reinitialised[row]:
            return Status.REINITIALISED
        return Status.TRACKING
