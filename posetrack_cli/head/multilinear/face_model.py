"""Multilinear model of identity and deformation (thesis, 4.2), and its file format."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.files import read_input, write_output
from posetrack_cli.head.face.points import POINT_COUNT, POINT_NAMES, ShapeModel
from posetrack_cli.npz import read_npz
from posetrack_cli.outputs import whole_or_nothing


@dataclass(frozen=True, eq=False)
class FaceModel:
    """M = Mbar + C x_shape s^T x_action a^T, (4.15).

    Identity s and deformation a have no unit; their distribution over the training people and actions is
    assumed normal.

    Attributes:
        mean: (K, 3) Mbar, mm in the head's frame.
        core: (K, 3, S, A) model tensor, mm.
        identity_mean: (S,) sbar.
        identity_deviations: (S,) sigma_s, all > 0.
        deformation_mean: (A,) abar.
        deformation_deviations: (A,) sigma_a, all > 0.
    """

    mean: FloatArray
    core: FloatArray
    identity_mean: FloatArray
    identity_deviations: FloatArray
    deformation_mean: FloatArray
    deformation_deviations: FloatArray

    @property
    def identity_size(self) -> int:
        """S', the number of identity parameters."""
        return len(self.identity_mean)

    @property
    def deformation_size(self) -> int:
        """A', the number of deformation parameters."""
        return len(self.deformation_mean)

    def shapes(self, identity: FloatArray, deformation: FloatArray) -> FloatArray:
        """Return the shapes (..., K, 3), mm, of s (..., S) and a (..., A), (4.15)."""
        shapes: FloatArray = self.mean + np.einsum("kisa,...s,...a->...ki", self.core, identity, deformation)
        return shapes

    def of_person(self, identity: FloatArray, offsets: FloatArray | None = None) -> ShapeModel:
        """Return the shape model of one person, (4.38), (4.39).

        Its coefficients are a - abar, so that 0 is the mean deformation, and the deviations sigma_a give the
        prior of (4.41).

        Args:
            identity: (S,) s.
            offsets: (K, 3) mm, offset of each image feature from the model's point; zero by default.
        """
        basis: FloatArray = np.einsum("kisa,s->kia", self.core, identity)
        mean = self.mean + basis @ self.deformation_mean
        shifted = mean if offsets is None else mean + offsets
        return ShapeModel(shifted, basis, self.deformation_deviations)


FORMAT, VERSION = "posetrack.face_model", 1
SHIPPED = Path(__file__).with_name("default.npz")
"""Built by ``scripts/build face-model`` from statistics of ICT-FaceKit (USC ICT, MIT licence)."""
_HEADER = "header"
_LARGEST = 1e9
"""Limit on coordinates, mm, and parameters; its reciprocal is the smallest standard deviation."""


def load_face_model(path: Path | None = None) -> FaceModel:
    """Read a face model, by default the shipped one.

    Raises:
        UsageError: the file does not exist.
        ResultError: not a face model, or damaged.
    """
    path = SHIPPED if path is None else path
    if not path.is_file():
        raise UsageError("no such face model", where=path)
    try:
        contents = read_npz(read_input(path, limits.MODEL_BYTES))
        _check_header(json.loads(str(contents[_HEADER])))
        return _checked(contents)
    except OSError as error:
        raise ResultError("cannot be read", where=path, found=error.strerror or error) from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ResultError(
            "not a face model",
            where=path,
            found=_message(error),
            expected="a file written by posetrack head build-model",
        ) from error


def save_face_model(path: Path, model: FaceModel, source: str) -> None:
    """Write a face model atomically; equal models give equal bytes.

    Args:
        path: the file.
        model: to write.
        source: description of the training data, for the file's header.

    Raises:
        ResultError: the file cannot be written.
    """
    header = {"format": FORMAT, "version": VERSION, "source": source, "points": list(POINT_NAMES)}
    arrays = {name: getattr(model, name) for name in sorted(_shapes(0, 0))}
    stream = BytesIO()
    np.savez(stream, **{_HEADER: np.array(json.dumps(header))}, **arrays)  # type: ignore[arg-type]
    with whole_or_nothing(path) as part:
        write_output(part, stream.getvalue())


def _shapes(identity: int, deformation: int) -> dict[str, tuple[int, ...]]:
    return {
        "mean": (POINT_COUNT, 3),
        "core": (POINT_COUNT, 3, identity, deformation),
        "identity_mean": (identity,),
        "identity_deviations": (identity,),
        "deformation_mean": (deformation,),
        "deformation_deviations": (deformation,),
    }


def _check_header(header: Any) -> None:
    if not isinstance(header, dict):
        raise ValueError(f"header of type {type(header).__name__}")
    if header.get("format") != FORMAT:
        raise ValueError(f"format {header.get('format')}")
    if header.get("version") != VERSION:
        raise ValueError(f"format version {header.get('version')}")
    if tuple(header.get("points", ())) != POINT_NAMES:
        raise ValueError("different feature points")


def _checked(arrays: Mapping[str, np.ndarray[Any, Any]]) -> FaceModel:
    core = arrays["core"]
    if core.ndim != 4 or 0 in core.shape:
        raise ValueError(f"array 'core' has shape {core.shape}")
    if max(core.shape[2:]) > limits.FACE_PARAMETERS:
        raise ValueError(
            f"array 'core' has shape {core.shape}, at most {limits.FACE_PARAMETERS} parameters of a kind"
        )
    expected = _shapes(*core.shape[2:])
    for name, shape in expected.items():
        array = arrays[name]
        if array.dtype.kind != "f" or array.shape != shape:
            raise ValueError(f"array '{name}' is {array.dtype} {array.shape}, with 'core' of {core.shape}")
        _check_values(name, array)
    return FaceModel(**{name: arrays[name].astype(np.float64) for name in expected})


def _check_values(name: str, array: np.ndarray[Any, Any]) -> None:
    """Reject implausible values, so that squares and quotients of the others are finite."""
    if not np.all(np.isfinite(array)):
        raise ValueError(f"array '{name}' has non-finite values")
    if name.endswith("deviations") and np.any(array <= 0.0):
        raise ValueError(f"array '{name}' has values that are not above 0")
    largest = float(np.abs(array).max())
    if largest > _LARGEST or (name.endswith("deviations") and float(array.min()) < 1.0 / _LARGEST):
        raise ValueError(f"array '{name}' has implausible values")


def _message(error: Exception) -> str:
    """Return the error's text; a KeyError contains only the name."""
    return f"array {error} is missing" if isinstance(error, KeyError) else str(error)
