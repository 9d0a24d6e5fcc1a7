"""Files of what was learned of a face: shape model and templates, for a later run of the same person.

An npz without pickle: the tracker's arrays, and a JSON text that says what they are. Results carry the same
bytes as their attachment ``model.npz``, so a result serves as a model file, too.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli import limits
from posetrack_cli.errors import PosetrackError, ResultError, UsageError
from posetrack_cli.files import read_input
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.face.points import POINT_NAMES
from posetrack_cli.mcap.stream import is_mcap
from posetrack_cli.npz import read_npz
from posetrack_cli.tracking.two_pass import Learned

FORMAT, VERSION = "posetrack.head_model", 1
ATTACHMENT, MEDIA_TYPE = "model.npz", "application/x-npz"
_EXPECTED = "what --save-model wrote, or a result of posetrack head"
_HEADER, _PREFIX = "header", "array."


def model_bytes(
    learned: Mapping[str, np.ndarray[Any, Any]], cameras: Sequence[Camera], tracker: str
) -> bytes:
    """Return the file of what a tracker learned with some cameras; the same bytes for the same arrays."""
    header = {
        "format": FORMAT,
        "version": VERSION,
        "tracker": tracker,
        "points": list(POINT_NAMES),
        "cameras": [camera.name for camera in cameras],
    }
    arrays = {f"{_PREFIX}{name}": values for name, values in sorted(learned.items())}
    stream = BytesIO()
    np.savez(stream, **{_HEADER: np.array(json.dumps(header))}, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def load_model(path: Path, cameras: Sequence[Camera], tracker: str) -> Learned:
    """Read what was learned of a face from a model file, or from a result that carries one.

    Args:
        path: the file.
        cameras: that the arrays are to be used with: as many as they were learned with.
        tracker: that uses them; what it knows is its own.

    Raises:
        UsageError: it does not exist, or is of another tracker or number of cameras.
        ResultError: it is neither, or damaged.
    """
    header, learned = read_model(path)
    if header["tracker"] != tracker:
        what = "model was learned by another tracker"
        raise UsageError(what, where=path, found=header["tracker"], expected=tracker)
    count = len(header["cameras"])
    if count != len(cameras):
        raise UsageError(
            "model was learned with another number of cameras",
            where=path,
            found=count,
            expected=len(cameras),
            hint="templates are kept for each camera",
        )
    return learned


def read_model(path: Path) -> tuple[dict[str, Any], Learned]:
    """Read what any tracker learned of a face: the header, with ``tracker`` and ``cameras``, and the arrays.

    Raises:
        UsageError: there is no such file.
        ResultError: it is neither a model file nor a result that carries one, or damaged.
    """
    from posetrack_cli.results.reader import read_result

    if not path.is_file():
        raise UsageError("no such model file", where=path)
    try:
        if is_mcap(path):
            result = read_result(path)
            if result.subject.name != "head":
                what = "result knows no head"
                raise ResultError(what, where=path, found=f"a {result.subject.name}", expected=_EXPECTED)
            data = result.attachment(ATTACHMENT)
        else:
            data = read_input(path, limits.MODEL_BYTES)
        contents = read_npz(data)
        header = json.loads(str(contents[_HEADER]))
        _check(header)
    except PosetrackError:
        raise
    except OSError as error:
        raise ResultError("cannot be read", where=path, found=error.strerror or error) from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        found = f"no {error}" if isinstance(error, KeyError) else error
        raise ResultError("is no model of a head", where=path, found=found, expected=_EXPECTED) from error
    learned = {name: values for name, values in contents.items() if name.startswith(_PREFIX)}
    return header, {name.removeprefix(_PREFIX): values for name, values in learned.items()}


def _check(header: Any) -> None:
    if not isinstance(header, dict):
        raise ValueError(f"a header that is a {type(header).__name__}")
    if (header["format"], header["version"]) != (FORMAT, VERSION):
        raise ValueError(f"{header['format']} version {header['version']}")
    if tuple(header["points"]) != POINT_NAMES:
        raise ValueError("other feature points")
    if not isinstance(header["tracker"], str) or not isinstance(header["cameras"], list):
        raise ValueError("a header without tracker and cameras")


def unusable(found: object, expected: str) -> ResultError:
    """Return the error that says what of learned arrays is not as it must be."""
    return ResultError("model is incomplete or damaged", found=found, expected=expected)
