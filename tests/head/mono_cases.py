"""Arrays and states of the one-camera tracker at random, and what it means that two are the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass

import numpy as np


def assert_same(first: object, second: object, where: str = "it") -> None:
    """Equal in every field, bit for bit; NaN is equal to NaN."""
    assert type(first) is type(second), where
    if is_dataclass(first):
        for one in fields(first):
            assert_same(getattr(first, one.name), getattr(second, one.name), f"{where}.{one.name}")
    elif isinstance(first, np.ndarray):
        assert first.dtype == second.dtype, where
        np.testing.assert_array_equal(first, second, err_msg=where)
    elif isinstance(first, Mapping):
        assert first.keys() == second.keys(), where
        for key in first:
            assert_same(first[key], second[key], f"{where}[{key!r}]")
    elif isinstance(first, (tuple, list)):
        assert len(first) == len(second), where
        for index, (one, other) in enumerate(zip(first, second, strict=True)):
            assert_same(one, other, f"{where}[{index}]")
    else:
        assert first == second or (first != first and second != second), where
