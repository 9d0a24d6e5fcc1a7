"""Joint position errors of a result against the truth that it carries."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.errors import ResultError
from posetrack_cli.results.reader import load_arrays, read_result


@dataclass(frozen=True, eq=False)
class JointErrors:
    """Euclidean distances between estimated and true joints, frame by frame.

    Attributes:
        distances_mm: (frames, joints), of the frames that have a truth of the same stamp.
        lost: (frames,) which of them the tracker called lost; their errors count all the same.
        unmatched: estimates without truth.
    """

    distances_mm: FloatArray
    lost: BoolArray
    unmatched: int

    def summary(self) -> str:
        """One line: mean, median, 95th percentile, lost and unmatched frames."""
        d = self.distances_mm
        return (
            f"joint error over {len(d)} frames: mean {d.mean():.1f} mm, median {np.median(d):.1f} mm, "
            f"95 % below {np.percentile(d, 95):.1f} mm; {int(self.lost.sum())} lost, "
            f"{self.unmatched} without truth"
        )


def joint_errors(path: Path) -> JointErrors:
    """Compare a result's joints with ``/truth/<subject>/estimate`` at equal stamps.

    Raises:
        ResultError: the result carries no truth, none at any of its stamps, or one of other joints.
    """
    topic = f"/truth/{read_result(path).subject.name}/estimate"
    estimated, true = load_arrays(path), load_arrays(path, topic)
    joints, true_joints = estimated["points"].shape[1], true["points"].shape[1]
    if joints != true_joints:
        raise ResultError(
            "truth has other joints", where=f"{path}, {topic}", found=true_joints, expected=joints
        )
    _, mine, theirs = np.intersect1d(estimated["stamp_ns"], true["stamp_ns"], return_indices=True)
    if not mine.size:
        raise ResultError("no truth at any of the stamps", where=f"{path}, {topic}")
    distances = np.linalg.norm(estimated["points"][mine] - true["points"][theirs], axis=2)
    lost = estimated["status"][mine] == "lost"
    return JointErrors(distances, lost, len(estimated["stamp_ns"]) - len(mine))
