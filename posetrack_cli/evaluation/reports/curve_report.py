"""The field's curve as CSV: share of frames whose joint errors are below D, a row for each D."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

import numpy as np

from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.evaluation import Evaluation

KINDS = ("largest", "mean")
"""Of a frame's joint errors."""


def curve_report(evaluations: Sequence[Evaluation]) -> str:
    """Return a table with the column ``d_mm``, and for each result ``NAME largest`` and ``NAME mean``.

    Shares, 0 to 1, are of the frames due: those that a result missed count as not below D.

    Raises:
        UsageError: no result has a curve: they are no hands, or there is no truth with joints.
    """
    curves = {one.name: one.curve for one in evaluations if one.curve is not None}
    if not curves:
        names = ", ".join(one.name for one in evaluations)
        raise UsageError("no curve: no result of a hand has a truth with joints", found=names)
    columns = [next(iter(curves.values())).thresholds_mm]
    columns += [shares for curve in curves.values() for shares in (curve.share, curve.mean_share)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["d_mm", *(f"{name} {kind}" for name in curves for kind in KINDS)])
    for row in np.stack(columns, axis=1).tolist():
        writer.writerow([f"{row[0]:g}", *row[1:]])
    return text.getvalue()
