"""What arrays must be that hold what was learned of a face, and whether those of a file are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from posetrack_cli.errors import ResultError
from posetrack_cli.head.face.points import POINT_COUNT
from posetrack_cli.head.face.templates import WINDOW
from posetrack_cli.results.layouts import Layout, LayoutError, check_arrays, counts, floats, places, units


def check_learned(arrays: Mapping[str, np.ndarray[Any, Any]], cameras: int) -> None:
    """Refuse arrays that no stereo tracker has learned.

    Args:
        arrays: face and templates, by name.
        cameras: C, how many the templates are to be of.

    Raises:
        ResultError: one is missing, or not as ``face_layouts`` and ``template_layouts`` state it.
    """
    try:
        check_arrays(arrays, face_layouts() | template_layouts("sets", cameras))
    except LayoutError as error:
        raise unusable(error, "what --save-model wrote of a stereo run") from error


def face_layouts() -> dict[str, Layout]:
    """Return what the arrays of a face that a stereo tracker learns must be; see ``Ccipca``."""
    return {
        "face.mean": floats(POINT_COUNT, 3),
        "face.components": floats("components", 3 * POINT_COUNT),
        "face.variance": floats(least=0.0),
        "face.counts": counts(3),
    }


def template_layouts(prefix: str, cameras: int, sets: int | None = None) -> dict[str, Layout]:
    """Return what arrays of templates must be, under names that begin with a prefix; see ``TemplateSet``.

    Args:
        prefix: of the names.
        cameras: C.
        sets: how many there are; None for any number from 1 on.
    """
    seen = (prefix if sets is None else sets, cameras, POINT_COUNT)
    layouts = {
        "windows": Layout("uint8", (*seen, WINDOW, WINDOW)),
        "centres": places(*seen, 2),
        "tangents": places(*seen, 2, 2),
        "seen": Layout("bool", seen),
        "facing": units(seen[0], 3),
    }
    return {f"{prefix}.{name}": layout for name, layout in layouts.items()}


def unusable(found: object, expected: str) -> ResultError:
    """Return the error that says what of learned arrays is not as it must be."""
    return ResultError("model is incomplete or damaged", found=found, expected=expected)
