"""Files of face models: what is written is read, what is something else is refused in one line."""

from __future__ import annotations

import json
import os
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.errors import PosetrackError, ResultError, UsageError
from posetrack_cli.head.face.points import EYES, MEAN_SHAPE, POINT_NAMES
from posetrack_cli.head.multilinear.build import build_model, mirrored
from posetrack_cli.head.multilinear.face_model import SHIPPED, FaceModel, load_face_model, save_face_model
from support.face_people import acting, people


@pytest.fixture(scope="module")
def model() -> FaceModel:
    return build_model(acting(people(3)), 4, 3).model


def arrays_of(model: FaceModel) -> dict[str, np.ndarray]:
    return {part.name: getattr(model, part.name) for part in fields(model)}


def write(path: Path, header: Any, arrays: dict[str, Any]) -> Path:
    np.savez(path, header=np.array(json.dumps(header)), **arrays)
    return path


HEADER = {"format": "posetrack.face_model", "version": 1, "points": list(POINT_NAMES)}


def refusal(path: Path) -> str:
    with pytest.raises(ResultError) as caught:
        load_face_model(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: not a face model, found ") and "\n" not in line
    return line


def test_what_is_written_is_read(model: FaceModel, tmp_path: Path) -> None:
    save_face_model(tmp_path / "face.npz", model, "three people")
    again = load_face_model(tmp_path / "face.npz")
    for name, values in arrays_of(model).items():
        np.testing.assert_array_equal(getattr(again, name), values)
    with np.load(tmp_path / "face.npz", allow_pickle=False) as contents:
        assert json.loads(str(contents["header"]))["source"] == "three people"


def test_the_same_model_gives_the_same_bytes(model: FaceModel, tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        save_face_model(tmp_path / name, model, "people")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_the_shipped_model_is_a_face() -> None:
    model = load_face_model()
    assert (model.identity_size, model.deformation_size) == (10, 6)
    face = model.shapes(model.identity_mean, model.deformation_mean)
    # at mean deformation the mouth is half open; features lie up to 13 mm from the landmarks
    assert np.linalg.norm(face - MEAN_SHAPE, axis=-1).max() < 15.0
    assert np.linalg.norm((face - MEAN_SHAPE)[EYES], axis=-1).max() < 5.0
    np.testing.assert_allclose(mirrored(face), face, atol=1e-6)  # its arrays are rounded
    with np.load(SHIPPED, allow_pickle=False) as contents:
        assert "ICT-FaceKit" in json.loads(str(contents["header"]))["source"]


def test_nothing_is_there(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such face model"):
        load_face_model(tmp_path / "none.npz")


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 but damaged"])
def test_other_bytes_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "face.npz"
    path.write_bytes(content)
    refusal(path)


def test_half_of_a_file_is_refused(model: FaceModel, tmp_path: Path) -> None:
    path = tmp_path / "face.npz"
    save_face_model(path, model, "people")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    refusal(path)


@pytest.mark.parametrize(
    ("key", "value", "found"),
    [
        ("format", "posetrack.head_model", "format posetrack.head_model"),
        ("version", 2, "format version 2"),
        ("points", ["nose"], "different feature points"),
    ],
)
def test_other_headers_are_refused(
    model: FaceModel, tmp_path: Path, key: str, value: object, found: str
) -> None:
    path = write(tmp_path / "face.npz", HEADER | {key: value}, arrays_of(model))
    assert f"found {found}" in refusal(path)


def test_headers_that_are_none_are_refused(model: FaceModel, tmp_path: Path) -> None:
    assert "header of type list" in refusal(write(tmp_path / "a.npz", ["a list"], arrays_of(model)))
    np.savez(tmp_path / "b.npz", **arrays_of(model))
    assert "array 'header' is missing" in refusal(tmp_path / "b.npz")


@pytest.mark.parametrize(
    ("name", "values", "found"),
    [
        ("core", np.zeros((10, 3, 4)), "array 'core' has shape (10, 3, 4)"),
        ("core", np.full((10, 3, 4, 3), np.nan), "array 'core' has non-finite values"),
        ("mean", np.zeros((9, 3)), "array 'mean' is float64 (9, 3)"),
        ("identity_mean", np.zeros(5), "array 'identity_mean' is float64 (5,)"),
        ("identity_deviations", np.zeros(4), "array 'identity_deviations' has values that are not above 0"),
        ("deformation_mean", np.array(["a", "b", "c"]), "array 'deformation_mean' is <U1 (3,)"),
        ("mean", np.full((10, 3), 1e300), "array 'mean' has implausible values"),
        ("identity_deviations", np.full(4, 1e-300), "array 'identity_deviations' has implausible values"),
        ("core", np.zeros((10, 3, 4, 300)), "array 'core' has shape (10, 3, 4, 300), at most 256 parameters"),
        ("core", np.zeros((10, 3, 0, 10**15)), "array 'core' has shape (10, 3, 0, 1000000000000000)"),
    ],
)
def test_other_arrays_are_refused(
    model: FaceModel, tmp_path: Path, name: str, values: np.ndarray, found: str
) -> None:
    path = write(tmp_path / "face.npz", HEADER, arrays_of(model) | {name: values})
    assert f"found {found}" in refusal(path)


def test_missing_arrays_are_refused(model: FaceModel, tmp_path: Path) -> None:
    arrays = arrays_of(model)
    del arrays["deformation_deviations"]
    assert "array 'deformation_deviations' is missing" in refusal(
        write(tmp_path / "face.npz", HEADER, arrays)
    )


def test_pickled_arrays_are_refused(model: FaceModel, tmp_path: Path) -> None:
    arrays = arrays_of(model) | {"core": np.array([{"a": 1}], dtype=object)}
    refusal(write(tmp_path / "face.npz", HEADER, arrays))


def test_a_small_file_of_large_arrays_is_refused(tmp_path: Path) -> None:
    """Compressed zeros of 300 MB, in a file of 300 KB."""
    path = tmp_path / "face.npz"
    np.savez_compressed(path, header=np.array(json.dumps(HEADER)), core=np.zeros((10, 3, 1, 1_250_000)))
    assert path.stat().st_size < 1 << 20
    assert "arrays of 30000" in refusal(path) and "limit of 268435456" in refusal(path)


def test_only_a_regular_file_is_a_model(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "face.npz")
    with pytest.raises(UsageError, match="no such face model"):
        load_face_model(tmp_path / "face.npz")


def test_a_folder_that_does_not_exist(model: FaceModel, tmp_path: Path) -> None:
    with pytest.raises(PosetrackError):
        save_face_model(tmp_path / "none" / "face.npz", replace(model), "people")
