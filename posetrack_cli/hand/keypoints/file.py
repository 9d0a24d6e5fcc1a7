"""Reads a file of keypoints: which layout it has, in what unit it is, whose sides it tells."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.errors import UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.keypoints.places import HAND_POINTS
from posetrack_cli.recording.identity import shown_name
from posetrack_cli.recording.keypoints.formats import parse_keypoints
from posetrack_cli.recording.keypoints.layout import (
    HANDEDNESS,
    METRES,
    MILLIMETRES,
    MIRRORED,
    NORMALISED,
    PIXELS,
    UNITS,
    KeypointSets,
)
from posetrack_cli.recording.keypoints.reading import (
    MOST_OF,
    digest_of,
    image_unit,
    in_pixels,
    known_scores,
)
from posetrack_cli.units import METRES_PER_MM

UNSURE = "unsure"
"""How sides are taken that may be the wrong way round."""
_NEAREST_M, _FARTHEST_M = 0.1, 10.0
_OF_WORLD = 20.0
"""Percent of normalised coordinates below 0, from which on their origin is taken to be in the hand."""


@dataclass(frozen=True, eq=False)
class KeypointFile:
    """Keypoints as a run uses them.

    Attributes:
        name, digest: of the file: its last part, and the SHA-256 of its bytes.
        sets: pixels, or mm in camera axes; scores are all known; sides are the hand's own.
        in_pixels: which of the two.
        unit: of the file, as it was told or determined.
        sides: how its sides are taken: ``none``, ``as told``, ``exchanged``, or ``UNSURE``: as told, by
            labels that some versions of MediaPipe mean otherwise.
    """

    name: str
    digest: str
    sets: KeypointSets
    in_pixels: bool
    unit: str
    sides: str

    def record(self) -> dict[str, str]:
        """Return what a result states of the file: all that its bytes depend on."""
        return {
            "keypoints": self.name,
            "keypoints.sha256": self.digest,
            "keypoints.unit": self.unit,
            "keypoints.sides": self.sides,
        }

    @property
    def line(self) -> str:
        """What was found, for people."""
        sets = self.sets
        by = "stamp" if sets.by_stamp else "number"
        labels = {
            "none": "no sides",
            "as told": "sides as told",
            "exchanged": "right and left exchanged",
            UNSURE: "handedness as told (MediaPipe before 0.10.15 exchanges it: --keypoints-swap-sides)",
        }
        return f"{len(sets)} hands of 21 points by frame {by}, in {self.unit}, {labels[self.sides]}"


def read_keypoints(
    path: Path, camera: Camera, unit: str | None = None, swap_sides: bool = False
) -> KeypointFile:
    """Read keypoints that another program found.

    Args:
        path: CSV; or JSON, one value (``.json``) or one per line (``.jsonl``, ``.ndjson``).
        camera: of the depth images, for normalised points.
        unit: one of ``UNITS``; None as the file names it, else as its numbers look.
        swap_sides: exchange right and left as they would be taken otherwise: labels of MediaPipe's solutions
            are taken as they are, others exchanged.

    Raises:
        UsageError: no such file; or names file, line and field of what cannot be used.
    """
    parsed = parse_keypoints(path, HAND_POINTS)
    unit = unit or parsed.unit or _unit_by_numbers(parsed.sets, camera, path)
    exchanged = (parsed.side_field == MIRRORED) != swap_sides
    sets = _in_our_units(parsed.sets, unit, camera, path)
    sides = "exchanged" if exchanged else (UNSURE if parsed.side_field == HANDEDNESS else "as told")
    sides = "none" if np.isnan(sets.right).all() else sides
    right = 1.0 - sets.right if exchanged else sets.right
    known = replace(sets, scores=known_scores(sets.scores), right=right)
    return KeypointFile(shown_name(path), digest_of(path), known, unit in (PIXELS, NORMALISED), unit, sides)


def _unit_by_numbers(sets: KeypointSets, camera: Camera, path: Path) -> str:
    """The unit that coordinates look like.

    Raises:
        UsageError: they look like none.
    """
    points = sets.points[np.isfinite(sets.points[..., 0])]
    if np.isfinite(points[:, 2]).all():
        low, high = np.percentile(points[:, 2], [100.0 - MOST_OF, MOST_OF])
        if METRES_PER_MM * low >= _NEAREST_M:
            return MILLIMETRES
        if low >= _NEAREST_M and high <= _FARTHEST_M:
            return METRES
    hint = "--keypoints-unit tells it; pixels are those of the depth images"
    unit = image_unit(points, camera, path, UNITS, hint)
    if unit == NORMALISED and np.percentile(points[:, :2].min(axis=1), _OF_WORLD) < 0.0:
        raise _no_place(path)
    return unit


def _no_place(path: Path) -> UsageError:
    return UsageError(
        "points have no place",
        where=path,
        found="coordinates about an origin in the hand, as MediaPipe's world landmarks have",
        expected="points in the image (px, normalised), or before the camera (mm, m; z is positive)",
        hint="take MediaPipe's image landmarks",
    )


def _in_our_units(sets: KeypointSets, unit: str, camera: Camera, path: Path) -> KeypointSets:
    """The sets in pixels, or in mm before the camera.

    Raises:
        UsageError: points in space lie behind the camera.
    """
    points = sets.points
    if unit in (PIXELS, NORMALISED):
        return in_pixels(sets, unit, camera)
    points = points / (METRES_PER_MM if unit == METRES else 1.0)
    known = np.isfinite(points[..., 0])
    if not np.isfinite(points[known]).all():
        what = "points in space need a z"
        raise UsageError(what, where=path, expected="x, y, z", hint="--keypoints-unit px is for images")
    if np.percentile(points[known][:, 2], _OF_WORLD) < limits.NEAREST_MM:
        raise _no_place(path)
    points[points[..., 2] < limits.NEAREST_MM] = np.nan
    return replace(sets, points=points)
