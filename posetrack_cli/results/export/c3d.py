"""Export of a track's points as C3D markers, the motion capture format (https://www.c3d.org).

Markers are the joints of a hand or the landmarks of a head, mm, in camera axes, as stated by the parameters
POINT:X_SCREEN and POINT:Y_SCREEN. C3D has a single frame rate (``table``). Missing markers, i.e. of lost
frames and frames without estimate, have a residual of -1; all others have 0, which means an unknown error.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.files import open_output
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.estimate import Status
from posetrack_cli.results.export.source import ExportSource
from posetrack_cli.results.export.table import FixedRate, fixed_rate

FIELDS = ("stamp_ns", "status", "points")
NOT_SEEN = -1.0
MOST_FRAMES, MOST_MARKERS, LONGEST_NAME = 65_535, 255, 127
"""Limits of C3D's 16-, 8- and 7-bit numbers."""


def write_c3d(source: ExportSource, path: Path) -> FixedRate:
    """Write a C3D file and return its frames.

    Raises:
        UsageError: ezc3d is not installed.
        ResultError: more frames or points, or longer names, than C3D supports; or see
            ``results.export.table``.
    """
    try:
        import ezc3d  # optional dependency, extra "c3d"
    except ImportError as error:
        raise UsageError("c3d needs ezc3d", hint="pip install 'posetrack[c3d]'") from error
    where, names = source.where, source.result.subject.point_names
    columns = source.columns(FIELDS)
    rate = fixed_rate(columns["stamp_ns"], where)
    _check(rate, names, where)
    points, residuals = _markers(columns, rate)
    file = ezc3d.c3d()
    parameters = file["parameters"]["POINT"]
    parameters["UNITS"]["value"] = ["mm"]
    parameters["RATE"]["value"] = [rate.rate_hz]
    parameters["LABELS"]["value"] = list(names)
    parameters["DESCRIPTIONS"]["value"] = [f"{source.result.subject.name} {name}" for name in names]
    file.add_parameter("POINT", "X_SCREEN", ["+X"])
    file.add_parameter("POINT", "Y_SCREEN", ["-Y"])
    file["data"]["points"] = points
    file["data"]["meta_points"]["residuals"] = residuals
    with TemporaryDirectory() as folder, open_output(path) as stream:
        named = Path(folder) / "track.c3d"  # ezc3d requires the suffix, which NAME.part lacks
        file.write(str(named))
        stream.write(named.read_bytes())
    return rate


def _check(rate: FixedRate, names: Sequence[str], where: str) -> None:
    longest = max((len(name.encode()) for name in names), default=0)
    for what, found, most in (
        ("frames", len(rate.rows), MOST_FRAMES),
        ("points", len(names), MOST_MARKERS),
        ("bytes in a point's name", longest, LONGEST_NAME),
    ):
        if found > most:
            hint = "csv, json and npz have no such limit"
            expected = f"at most {most}"
            raise ResultError(
                f"too many {what} for C3D", where=where, found=found, expected=expected, hint=hint
            )


def _markers(columns: Columns, rate: FixedRate) -> tuple[FloatArray, FloatArray]:
    """Return homogeneous markers (4, P, F) and residuals (1, P, F); missing markers are NaN."""
    count = columns["points"].shape[1]
    points = np.full((4, count, len(rate.rows)), np.nan)
    seen = rate.known.copy()
    seen[seen] = columns["status"][rate.rows[rate.known]] != Status.LOST.value
    points[:3, :, seen] = columns["points"][rate.rows[seen]].transpose(2, 1, 0)
    points[3] = 1.0
    residuals = np.where(seen, 0.0, NOT_SEEN)
    return points, np.broadcast_to(residuals, (1, count, len(seen))).copy()
