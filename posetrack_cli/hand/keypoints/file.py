"""Reader of keypoint files: layout, unit and side labels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.errors import UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.keypoints.targets import HAND_POINTS
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
"""Side labels that may be swapped."""
_NEAREST_M, _FARTHEST_M = 0.1, 10.0
_WORLD_PERCENT = 20.0
"""Share of negative normalised coordinates, %, above which the origin is taken to be inside the hand."""


@dataclass(frozen=True, eq=False)
class KeypointFile:
    """Keypoints in a run's units.

    Attributes:
        name, digest: file name and SHA-256 of the file.
        sets: in pixels, or in mm in camera axes; all scores are known, sides are anatomical.
        in_pixels: whether the sets are in pixels.
        unit: unit of the file, as given or determined.
        sides: interpretation of its labels: ``none``, ``as told``, ``exchanged``, or ``UNSURE``: used
            unchanged, although some versions of MediaPipe swap them.
    """

    name: str
    digest: str
    sets: KeypointSets
    in_pixels: bool
    unit: str
    sides: str

    def record(self) -> dict[str, str]:
        """Return the entries of the run record: everything the result depends on."""
        return {
            "keypoints": self.name,
            "keypoints.sha256": self.digest,
            "keypoints.unit": self.unit,
            "keypoints.sides": self.sides,
        }

    @property
    def line(self) -> str:
        """Return a one-line summary."""
        sets = self.sets
        by = "stamp" if sets.by_stamp else "number"
        labels = {
            "none": "no side labels",
            "as told": "sides as labelled",
            "exchanged": "right and left swapped",
            UNSURE: "sides as labelled (MediaPipe before 0.10.15 swaps them: --keypoints-swap-sides)",
        }
        return f"{len(sets)} hands of 21 points by frame {by}, in {self.unit}, {labels[self.sides]}"


def read_keypoints(
    path: Path, camera: Camera, unit: str | None = None, swap_sides: bool = False
) -> KeypointFile:
    """Read keypoints of another program.

    Args:
        path: CSV, or JSON with one value (``.json``) or one per line (``.jsonl``, ``.ndjson``).
        camera: of the depth images, for normalised points.
        unit: one of ``UNITS``; by default the unit named in the file or inferred from its numbers.
        swap_sides: swap right and left. Labels of MediaPipe's solutions are used unchanged by default, others
            swapped.

    Raises:
        UsageError: no such file, or invalid content, with file, line and field.
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
    """Infer the unit from the coordinates.

    Raises:
        UsageError: they match no unit.
    """
    points = sets.points[np.isfinite(sets.points[..., 0])]
    if np.isfinite(points[:, 2]).all():
        low, high = np.percentile(points[:, 2], [100.0 - MOST_OF, MOST_OF])
        if METRES_PER_MM * low >= _NEAREST_M:
            return MILLIMETRES
        if low >= _NEAREST_M and high <= _FARTHEST_M:
            return METRES
    hint = "set --keypoints-unit; pixels are those of the depth images"
    unit = image_unit(points, camera, path, UNITS, hint)
    if unit == NORMALISED and np.percentile(points[:, :2].min(axis=1), _WORLD_PERCENT) < 0.0:
        raise _no_place(path)
    return unit


def _no_place(path: Path) -> UsageError:
    return UsageError(
        "points have no position in the image",
        where=path,
        found="coordinates relative to the hand, such as MediaPipe's world landmarks",
        expected="image points (px, normalised), or points in front of the camera (mm, m; z > 0)",
        hint="export MediaPipe's image landmarks",
    )


def _in_our_units(sets: KeypointSets, unit: str, camera: Camera, path: Path) -> KeypointSets:
    """Return the sets in pixels, or in mm in front of the camera.

    Raises:
        UsageError: points in space lie behind the camera.
    """
    points = sets.points
    if unit in (PIXELS, NORMALISED):
        return in_pixels(sets, unit, camera)
    points = points / (METRES_PER_MM if unit == METRES else 1.0)
    known = np.isfinite(points[..., 0])
    if not np.isfinite(points[known]).all():
        raise UsageError(
            "points have no z",
            where=path,
            expected="x, y, z",
            hint="use --keypoints-unit px for image points",
        )
    if np.percentile(points[known][:, 2], _WORLD_PERCENT) < limits.NEAREST_MM:
        raise _no_place(path)
    points[points[..., 2] < limits.NEAREST_MM] = np.nan
    return replace(sets, points=points)
