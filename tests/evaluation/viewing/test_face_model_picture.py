"""The picture of a face model: its cells, and that faces in it differ where the model's do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posetrack_cli.evaluation.viewing.drawing import SKIN
from posetrack_cli.evaluation.viewing.face_picture import DEFORMATION_AXES, IDENTITY_AXES, face_model_picture
from posetrack_cli.head.multilinear.face_model import load_face_model

ROWS, COLUMNS = 1 + 2 * IDENTITY_AXES, 1 + 2 * DEFORMATION_AXES


def cells(picture: np.ndarray, rows: int = ROWS, columns: int = COLUMNS) -> list[list[np.ndarray]]:
    return [np.split(row, columns, axis=1) for row in np.split(picture, rows, axis=0)]


def drawn(cell: np.ndarray) -> np.ndarray:
    """Where the face is, without the caption below it."""
    return np.all(cell[:-24] == SKIN, axis=-1)


def test_every_cell_shows_another_face() -> None:
    faces = [drawn(cell) for row in cells(face_model_picture(load_face_model())) for cell in row]
    assert all(face.sum() > 200 for face in faces)
    assert len({face.tobytes() for face in faces}) == len(faces)


def test_no_face_reaches_the_edge() -> None:
    for row in cells(face_model_picture(load_face_model())):
        for cell in row:
            face = drawn(cell)
            assert not face[0].any() and not face[-1].any() and not face[:, 0].any() and not face[:, -4].any()


def test_faces_from_the_front_are_symmetric() -> None:
    front = drawn(cells(face_model_picture(load_face_model()))[0][0])[:, : round(1.6 * 116.0)]
    columns = np.flatnonzero(front.any(axis=0))
    middle = 0.5 * (columns[0] + columns[-1])
    assert abs(middle - 1.6 * 58.0) <= 1.0


def test_a_model_of_few_parameters_has_few_cells() -> None:
    model = load_face_model()
    small = replace(
        model,
        core=model.core[..., :1, :2],
        identity_mean=model.identity_mean[:1],
        identity_deviations=model.identity_deviations[:1],
        deformation_mean=model.deformation_mean[:2],
        deformation_deviations=model.deformation_deviations[:2],
    )
    assert len(cells(face_model_picture(small), 3, 5)) == 3
