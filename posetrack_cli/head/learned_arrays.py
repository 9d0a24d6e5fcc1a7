"""Whether arrays that a file gives as learned are all there, and of the shapes that a tracker's have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from posetrack_cli.errors import ResultError
from posetrack_cli.head.face import POINT_COUNT
from posetrack_cli.head.templates import WINDOW

ANY = -1
"""As long as it likes, but not empty."""
Expected = tuple[str, tuple[int, ...]]
"""Kinds of dtype, and shape."""


def check_learned(arrays: Mapping[str, np.ndarray[Any, Any]], cameras: int) -> None:
    """Refuse arrays that no stereo tracker has learned.

    Args:
        arrays: face and templates, by name.
        cameras: C, how many the templates are to be of.

    Raises:
        ResultError: one is missing, has another shape or kind, or is not finite where it must be.
    """
    for name, (kinds, shape) in _expected(cameras).items():
        array = arrays.get(name)
        if array is None:
            raise _unusable(f"no array '{name}'")
        if array.dtype.kind not in kinds or not fits(array.shape, shape):
            raise _unusable(f"'{name}' as {array.dtype} {array.shape}")
        if name.startswith("face.") and not np.all(np.isfinite(array)):
            raise _unusable(f"'{name}' with values that are not finite")
    if len({len(arrays[name]) for name in arrays if name.startswith("sets.")}) > 1:
        raise _unusable("template arrays of different lengths")


def _expected(cameras: int) -> dict[str, Expected]:
    """By name; see ``Ccipca``."""
    return {
        "face.mean": ("f", (POINT_COUNT, 3)),
        "face.components": ("f", (ANY, 3 * POINT_COUNT)),
        "face.variance": ("f", ()),
        "face.counts": ("iu", (3,)),
    } | template_arrays(cameras)


def template_arrays(cameras: int) -> dict[str, Expected]:
    """Return what templates of so many cameras are, as arrays by name; see ``TemplateSet``."""
    seen = (ANY, cameras, POINT_COUNT)
    return {
        "sets.windows": ("u", (*seen, WINDOW, WINDOW)),
        "sets.centres": ("f", (*seen, 2)),
        "sets.tangents": ("f", (*seen, 2, 2)),
        "sets.seen": ("b", seen),
        "sets.facing": ("f", (ANY, 3)),
    }


def fits(shape: tuple[int, ...], expected: tuple[int, ...]) -> bool:
    """Whether an array's shape is the one expected, and nothing is missing along an axis of any length."""
    if len(shape) != len(expected) or 0 in shape:
        return False
    return all(most == ANY or length == most for length, most in zip(shape, expected, strict=True))


def _unusable(found: str) -> ResultError:
    return ResultError(
        "model is incomplete or damaged", found=found, expected="what --save-model wrote of a stereo run"
    )
