from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from posetrack_cli.errors import ResultError
from posetrack_cli.results.estimate import Estimate, Subject
from posetrack_cli.results.fields import BY_NAME, check_estimate
from support.results import SUBJECT, make_estimate, with_fields


def test_the_table_lists_the_fields_in_their_order() -> None:
    assert tuple(BY_NAME) == tuple(field.name for field in fields(Estimate))


def test_a_sound_estimate_passes() -> None:
    check_estimate(make_estimate(0), SUBJECT)


@pytest.mark.parametrize("name", ["position", "shape", "pose_rate", "twist", "pose_variance", "points"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nan_and_infinity_are_refused_by_frame_and_field(name: str, value: float) -> None:
    array = getattr(make_estimate(12), name).copy()
    array.flat[-1] = value
    with pytest.raises(ResultError, match=f"frame 12: {name} is not finite"):
        check_estimate(with_fields(make_estimate(12), **{name: array}), SUBJECT)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"shape": np.zeros(15)}, r"shape has the wrong shape, found \(15,\), expected \(3,\)"),
        ({"quaternion": np.array([0.0, 0.0, 0.0, 2.0])}, "norm 2"),
        ({"quaternion": np.array([0.0, 0.0, 0.0, -1.0])}, "w -1"),
        ({"confidence": 1.5}, "confidence"),
        ({"confidence": float("nan")}, "confidence"),
        ({"effective_sample_size": float("nan")}, "effective sample size"),
    ],
)
def test_what_does_not_fit_the_subject_is_refused(fields: dict[str, object], message: str) -> None:
    with pytest.raises(ResultError, match=message):
        check_estimate(with_fields(make_estimate(0), **fields), SUBJECT)


def test_a_velocity_may_be_unknown_but_not_in_part() -> None:
    unknown = {"pose_rate": None, "twist": None, "twist_variance": None}
    check_estimate(with_fields(make_estimate(0), **unknown), SUBJECT)
    for name, array in ((name, getattr(make_estimate(0), name)) for name in unknown):
        with pytest.raises(ResultError, match="expected all velocity fields or none"):
            check_estimate(with_fields(make_estimate(0), **{**unknown, name: array}), SUBJECT)


def test_an_optimiser_knows_neither_variance_nor_weights() -> None:
    unknown = {"pose_variance": None, "effective_sample_size": None, "evaluations": 1600}
    check_estimate(with_fields(make_estimate(0), **unknown), SUBJECT)


@pytest.mark.parametrize(
    ("name", "parents", "triangles", "message"),
    [
        ("a/b", (-1, 0), None, "without slashes"),
        ("hand", (-1,), None, "2 names and 1 parents"),
        ("hand", (1, -1), None, "parent of point a"),
        ("hand", (-1, 0), np.zeros(6, dtype=np.int64), "triangles"),
    ],
)
def test_a_subject_that_does_not_fit_together_is_refused(
    name: str, parents: tuple[int, ...], triangles: np.ndarray | None, message: str
) -> None:
    with pytest.raises(ResultError, match=message):
        Subject(name, "camera", (), ("a", "b"), parents, triangles)
