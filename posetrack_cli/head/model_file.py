"""Model files: a learned face (shape model and templates) for later runs of the same person.

The file is an npz without pickled objects: the tracker's arrays and a JSON header. Results contain the same
bytes as attachment ``model.npz``, so a result also serves as a model file.
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
_EXPECTED = "a file from --save-model or a result of posetrack head"
_HEADER, _PREFIX = "header", "array."


def model_bytes(
    learned: Mapping[str, np.ndarray[Any, Any]], cameras: Sequence[Camera], tracker: str
) -> bytes:
    """Serialise a learned face and the names of its cameras; equal arrays give equal bytes."""
    header = {
        "format": FORMAT,
        "version": VERSION,
        "tracker": tracker,
        "points": list(POINT_NAMES),
        "cameras": [camera.name for camera in cameras],
    }
    # sorted and uncompressed, for reproducible bytes
    arrays = {f"{_PREFIX}{name}": values for name, values in sorted(learned.items())}
    stream = BytesIO()
    np.savez(stream, **{_HEADER: np.array(json.dumps(header))}, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def load_model(path: Path, cameras: Sequence[Camera], tracker: str) -> Learned:
    """Read a learned face from a model file or a result.

    Args:
        path: the file.
        cameras: of the new run; their number must equal that of the file.
        tracker: name of the tracker that uses the model.

    Raises:
        UsageError: the file does not exist, or another tracker or number of cameras produced it.
        ResultError: not a model file or result, or damaged.
    """
    header, learned = read_model(path)
    if header["tracker"] != tracker:
        what = "model belongs to another tracker"
        raise UsageError(what, where=path, found=header["tracker"], expected=tracker)
    count = len(header["cameras"])
    if count != len(cameras):
        raise UsageError(
            "model has a different number of cameras",
            where=path,
            found=count,
            expected=len(cameras),
            hint="the model contains templates for each camera",
        )
    return learned


def read_model(path: Path) -> tuple[dict[str, Any], Learned]:
    """Read header and arrays of a learned face of any tracker.

    Raises:
        UsageError: the file does not exist.
        ResultError: not a model file or a result with one, or damaged.
    """
    from posetrack_cli.results.reader import read_result

    if not path.is_file():
        raise UsageError("no such model file", where=path)
    try:
        if is_mcap(path):
            result = read_result(path)
            if result.subject.name != "head":
                what = "not a result of a head tracker"
                raise ResultError(what, where=path, found=f"a {result.subject.name}", expected=_EXPECTED)
            data = result.attachment(ATTACHMENT)
        else:
            data = read_input(path, limits.MODEL_BYTES)
        contents = read_npz(data)
        header = json.loads(str(contents[_HEADER]))
        _check(header)
    except PosetrackError:  # it names the file already
        raise
    except OSError as error:
        raise ResultError("cannot be read", where=path, found=error.strerror or error) from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        found = f"no {error}" if isinstance(error, KeyError) else error
        raise ResultError("not a head model", where=path, found=found, expected=_EXPECTED) from error
    learned = {name: values for name, values in contents.items() if name.startswith(_PREFIX)}
    return header, {name.removeprefix(_PREFIX): values for name, values in learned.items()}


def _check(header: Any) -> None:
    if not isinstance(header, dict):
        raise ValueError(f"header of type {type(header).__name__}")
    if (header["format"], header["version"]) != (FORMAT, VERSION):
        raise ValueError(f"{header['format']} version {header['version']}")
    if tuple(header["points"]) != POINT_NAMES:
        raise ValueError("different feature points")
    if not isinstance(header["tracker"], str) or not isinstance(header["cameras"], list):
        raise ValueError("header without tracker and cameras")


def damaged_model(found: object, expected: str) -> ResultError:
    """Return the error for learned arrays with an unexpected layout."""
    return ResultError("model is incomplete or damaged", found=found, expected=expected)
