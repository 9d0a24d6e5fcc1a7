"""The curve as CSV."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest

from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.measuring.evaluation import Curve
from posetrack_cli.evaluation.reports.report_files import curve_report
from support.evaluation import hand_evaluation


def test_a_row_for_each_threshold_and_two_columns_for_each_result() -> None:
    thresholds = np.array([0.0, 10.0, 20.0])
    a = hand_evaluation("a", curve=Curve(thresholds, np.array([0.0, 0.25, 1.0]), np.array([0.0, 0.5, 1.0])))
    b = hand_evaluation("b", curve=Curve(thresholds, np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, 1 / 3])))
    without = hand_evaluation("c", curve=None)
    rows = list(csv.reader(io.StringIO(curve_report([a, without, b]))))
    assert rows[0] == ["d_mm", "a largest", "a mean", "b largest", "b mean"]
    assert [row[0] for row in rows[1:]] == ["0", "10", "20"]
    assert [float(cell) for cell in rows[2][1:]] == [0.25, 0.5, 0.0, 0.0]
    assert float(rows[3][4]) == 1 / 3  # every digit


def test_without_any_curve_there_is_nothing_to_write() -> None:
    with pytest.raises(UsageError, match=r"no curve: .*found a, b"):
        curve_report([hand_evaluation("a", curve=None), hand_evaluation("b", curve=None)])
