"""The separated model of identity and deformation (thesis, 4.2), its files, and the one that is shipped."""

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

    Identity s and deformation a have no unit; their distribution over the people and actions that the model
    was built from is taken for normal.

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
        """Return how one person's face deforms, (4.38), (4.39).

        Its coefficients are a - abar, so that 0 is the mean deformation: with the deviations sigma_a their
        prior is that of (4.41).

        Args:
            identity: (S,) s.
            offsets: (K, 3) mm, how far each image feature lies from the model's point; none without.
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
"""Of coordinates, mm, and of parameters; no deviation is smaller than its reciprocal."""


def load_face_model(path: Path | None = None) -> FaceModel:
    """Read a face model; none is the shipped one.

    Raises:
        UsageError: the file does not exist.
        ResultError: it is no face model, or damaged.
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
            "is no face model",
            where=path,
            found=_message(error),
            expected="what posetrack head build-model wrote",
        ) from error


def save_face_model(path: Path, model: FaceModel, source: str) -> None:
    """Write a face model, whole or not at all; the same bytes for the same model.

    Args:
        path: the file.
        model: to write.
        source: what it was built from, in words, for the file's header.

    Raises:
        ResultError: it cannot be written.
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
        raise ValueError(f"a header that is a {type(header).__name__}")
    if header.get("format") != FORMAT:
        raise ValueError(f"format {header.get('format')}")
    if header.get("version") != VERSION:
        raise ValueError(f"version {header.get('version')} of the format")
    if tuple(header.get("points", ())) != POINT_NAMES:
        raise ValueError("other feature points")


def _checked(arrays: Mapping[str, np.ndarray[Any, Any]]) -> FaceModel:
    core = arrays["core"]
    if core.ndim != 4 or 0 in core.shape:
        raise ValueError(f"array 'core' of shape {core.shape}")
    if max(core.shape[2:]) > limits.FACE_PARAMETERS:
        raise ValueError(
            f"array 'core' of {core.shape}, at most {limits.FACE_PARAMETERS} parameters of a kind"
        )
    expected = _shapes(*core.shape[2:])
    for name, shape in expected.items():
        array = arrays[name]
        if array.dtype.kind != "f" or array.shape != shape:
            raise ValueError(f"array '{name}' as {array.dtype} {array.shape} beside 'core' of {core.shape}")
        _check_values(name, array)
    return FaceModel(**{name: arrays[name].astype(np.float64) for name in expected})


def _check_values(name: str, array: np.ndarray[Any, Any]) -> None:
    """Refuse values of no face: squares and quotients of those that are left are numbers, too."""
    if not np.all(np.isfinite(array)):
        raise ValueError(f"array '{name}' with values that are not finite")
    if name.endswith("deviations") and np.any(array <= 0.0):
        raise ValueError(f"array '{name}' with values that are not above 0")
    largest = float(np.abs(array).max())
    if largest > _LARGEST or (name.endswith("deviations") and float(array.min()) < 1.0 / _LARGEST):
        raise ValueError(f"array '{name}' with values far beyond a face's")


def _message(error: Exception) -> str:
    """The error's words; a KeyError's are only a name."""
    return f"no array {error}" if isinstance(error, KeyError) else str(error)
