"""A person's head as it can be drawn: neutral skin, what expressions move, and the ten true points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face.points import MEAN_SHAPE
from posetrack_cli.synthesis.head.expressions import belongs_below, displacements
from posetrack_cli.synthesis.head.form import MOUTH_X, MOUTH_Y, angle_of, forward, smooth_head
from posetrack_cli.synthesis.head.identity import Identity, hair_share
from posetrack_cli.synthesis.head.skin_grid import POCKET_MM, SkinGrid
from posetrack_cli.synthesis.head.smooth import Displacements, smooth_step

REACH_MM = 30.0
EAR_MIDDLE = np.array([72.0, -16.0, -88.0])
EAR_MM = np.array([7.0, 31.0, 17.0])


@dataclass(frozen=True, eq=False)
class Person:
    """A head that deforms linearly: skin = neutral + sum_j strength_j moved_j.

    Attributes:
        neutral: (R, C, 3) vertices of ``skin_grid``, mm, head's frame.
        moved: (J, R, C, 3) displacement by each of ``EXPRESSIONS`` at full strength, mm.
        points: (K, 3) the feature points of the neutral face, on the skin.
        points_moved: (J, K, 3) theirs.
        ears: right and left, grids of vertices, mm.
    """

    neutral: FloatArray
    moved: FloatArray
    points: FloatArray
    points_moved: FloatArray
    ears: tuple[FloatArray, FloatArray]

    def skin(self, strengths: FloatArray) -> FloatArray:
        """The vertices (R, C, 3), mm, under strengths (J,)."""
        skin: FloatArray = self.neutral + np.tensordot(strengths, self.moved, axes=1)
        return skin

    def shape(self, strengths: FloatArray) -> FloatArray:
        """The feature points (..., K, 3), mm, under strengths (..., J)."""
        shape: FloatArray = self.points + np.tensordot(strengths, self.points_moved, axes=1)
        return shape


def make_person(identity: Identity, grid: SkinGrid) -> Person:
    """Return the head of an identity."""
    places = _with_face(grid.places, identity)
    places[grid.inside, :, 2] -= _pocket_depth(grid)
    ten = _with_face(_ten_places(), identity)
    proportions = _Proportions(ten, identity.points)
    below = _below(grid)
    vertices = proportions(places) + _hair(grid, identity)
    moved = displacements(places, below, identity.looks)
    points_moved = displacements(ten, belongs_below(ten[:, 0], ten[:, 1]), identity.looks)
    ears = proportions(ear_vertices(-1.0)), proportions(ear_vertices(1.0))
    return Person(vertices, moved, proportions(ten), points_moved, ears)


def _ten_places() -> FloatArray:
    """The feature points (K, 3) on the smooth average head."""
    x, y = MEAN_SHAPE[:, 0], MEAN_SHAPE[:, 1]
    return smooth_head(angle_of(x, y), y)


def _with_face(places: FloatArray, identity: Identity) -> FloatArray:
    """Places (..., 3) of the smooth head after the face's relief, which fades towards the head's sides."""
    faced = places.copy()
    facing = np.clip((places[..., 2] + 70.0) / 40.0, 0.0, 1.0)
    faced[..., 2] += facing * forward(places[..., 0], places[..., 1], identity.relief)
    return faced


class _Proportions:
    """Takes the average head to one whose ten points lie where they shall: stretched, then bent."""

    def __init__(self, ten: FloatArray, wanted: FloatArray) -> None:
        self._factors = np.ones(3)
        for axis in (0, 1):
            self._factors[axis] = np.sum(ten[:, axis] * wanted[:, axis]) / np.sum(ten[:, axis] ** 2)
        self._factors[2] = np.sqrt(self._factors[0] * self._factors[1])
        self._bend = Displacements(ten, wanted - ten * self._factors, REACH_MM)

    def __call__(self, places: FloatArray) -> FloatArray:
        moved: FloatArray = places * self._factors + self._bend(places)
        return moved


def _pocket_depth(grid: SkinGrid) -> FloatArray:
    """How deep (rows inside, C) the pocket behind the lips is, mm: not at all at the mouth's corners."""
    x = grid.places[grid.inside, :, 0]
    front = grid.places[grid.inside, :, 2] > 0.0
    across = np.sqrt(np.clip(1.0 - (x / MOUTH_X) ** 2, 0.0, 1.0)) * front
    depth: FloatArray = POCKET_MM * np.sin(np.pi * grid.pocket[grid.inside])[:, None] ** 0.6 * across
    return depth


def _below(grid: SkinGrid) -> FloatArray:
    """Which share (R, C) of each vertex moves with the lower jaw's side."""
    x, y = grid.places[..., 0], grid.places[..., 1]
    share = belongs_below(x, y)
    between = (np.abs(x) < MOUTH_X - 1e-9) & (np.abs(y - MOUTH_Y) < 1e-9) & (grid.places[..., 2] > 0.0)
    rows = np.broadcast_to(smooth_step((grid.pocket - 0.35) / 0.3)[:, None], share.shape)
    return np.where(between, rows, share)


def _hair(grid: SkinGrid, identity: Identity) -> FloatArray:
    """Displacement (R, C, 3) by the hair, away from the head's middle."""
    share = hair_share(grid.places, identity.looks, soft_mm=30.0)
    outward = grid.places - np.array([0.0, 20.0, -80.0])
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
    displacement: FloatArray = identity.looks.hair_volume * share[..., None] * outward
    return displacement


def ear_vertices(side: float) -> FloatArray:
    """Return the grid (13, 25, 3) of an ear, mm, head's frame; side 1 is the subject's left, -1 the right."""
    across = np.linspace(-np.pi, np.pi, 25)[None, :]
    down = np.linspace(0.5 * np.pi, -0.5 * np.pi, 13)[:, None]
    y, z = np.broadcast_arrays(np.sin(down), np.cos(down) * np.cos(across))
    x = np.cos(down) * np.sin(across)
    rim = 1.0 - 0.75 * np.exp(-0.5 * ((np.hypot(y, 1.3 * z)) / 0.45) ** 2)  # hollow in the middle
    ear = np.stack([x * rim, y, z - 0.2 * y], axis=-1) * EAR_MM
    ear[..., 0] += 0.3 * np.maximum(-ear[..., 2], 0.0)
    placed: FloatArray = (ear + EAR_MIDDLE) * [side, 1.0, 1.0]
    return placed
