"""The format of numpy: arrays in one file, without pickling."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from posetrack_cli.files import open_output
from posetrack_cli.results.estimate import NUMBERS
from posetrack_cli.results.export.header import header_values
from posetrack_cli.results.export.source import ExportSource
from posetrack_cli.results.export.table import euler_angles

UNITS = {
    "stamp_ns": "ns",
    "position": "mm, camera axes",
    "quaternion": "x y z w, object to camera axes",
    "roll_pitch_yaw_deg": "deg",
    "shape": "hand: finger angles, rad; head: coefficients",
    "pose_rate": "rate of position, quaternion, shape: mm/s, 1/s, rad/s (head: 1/s)",
    "twist": "mm/s in camera axes, rad/s in the object's own axes, shape per second",
    "pose_variance": "mm^2, rad^2 (small rotation in the object's own axes), shape^2",
    "twist_variance": "(mm/s)^2, (rad/s)^2, (shape per second)^2",
    "points": "mm, camera axes",
    "effective_sample_size": "particles",
    "cost": "mm",
    "milliseconds": "ms",
    "evaluations": "poses",
}
NUMBERS_UNIT = "as number_names say"


def write_npz(source: ExportSource, path: Path) -> None:
    """Write every field of the estimates as one array, frames first.

    Beside them: ``roll_pitch_yaw_deg`` (N, 3), ``shape_names``, ``point_names``, ``number_names`` where there
    are further numbers, and ``header``, a JSON text that states units, Euler order and the run record.
    """
    columns = source.columns()
    subject = source.result.subject
    header = {key: value for key, value in header_values(source).items() if key != "meanings"}
    header["units"] = {**UNITS, **({NUMBERS: NUMBERS_UNIT} if subject.number_names else {})}  # of arrays
    extras = {
        "roll_pitch_yaw_deg": np.degrees(euler_angles(subject)(columns["quaternion"])),
        "shape_names": np.array(subject.shape_names, dtype=np.str_),
        "point_names": np.array(subject.point_names, dtype=np.str_),
        "header": np.array(json.dumps(header, ensure_ascii=False)),
    }
    if subject.number_names:
        extras["number_names"] = np.array(subject.number_names, dtype=np.str_)
    with open_output(path) as stream:
        np.savez(stream, **columns, **extras)  # type: ignore[arg-type]
