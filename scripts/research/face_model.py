"""Build the shipped face model from faces and expressions drawn from statistics of ICT-FaceKit.

ICT-FaceKit is a face model of the USC Institute for Creative Technologies (MIT licence). The statistics are
mean, identity modes and expressions of the ten feature points, mm in the head frame.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import click
import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.reading.truth_tables import load_csv_track
from posetrack_cli.geometry.rigid import in_object
from posetrack_cli.head.actions import USUAL, displacement
from posetrack_cli.head.detection.appearance import RIGHT_SIDE
from posetrack_cli.head.face.points import EYES, MIRRORED, POINT_NAMES
from posetrack_cli.head.multilinear.build import BuiltModel, add_deformation, build_model, mirrored
from posetrack_cli.head.multilinear.face_model import SHIPPED, FaceModel, save_face_model
from posetrack_cli.head.subject import head_subject
from research.heads import TRUTH

SOURCE = "statistics of ICT-FaceKit (USC Institute for Creative Technologies, MIT licence)"
PEOPLE, SEED = 60, 1  # number of drawn identities; the negative of each is used as well
DECIMALS = 9  # rounding of the arrays, which removes differences between machines
Expression = Mapping[str, float]


def _both_sides(right: Sequence[tuple[float, float, float]]) -> FloatArray:
    """Return all points (K, 3), given those of the right side."""
    found = np.empty((len(POINT_NAMES), 3))
    found[list(RIGHT_SIDE)] = right
    found[np.array(MIRRORED)[list(RIGHT_SIDE)]] = np.array(right) * (-1.0, 1.0, 1.0)
    return found


# (K, 3) mm, mean offset from the statistics' landmarks to the tracked features **[ours]**, from
# ``measured_offsets`` on the ten recordings person-c to person-l of the study.
#
# These faces are larger than the statistics' mean face, and the visible nostril openings and brow ends lie
# next to the vertices. A model built from tracking results needs no offsets.
FEATURE_OFFSETS = _both_sides(
    [(-2.2, 0.0, 1.9), (-1.6, 0.2, 2.3), (-1.7, 0.2, -0.2), (-3.1, 2.3, 3.8), (-4.9, -10.1, 6.5)]
)

# (K, 3) mm in the head frame: offset from mesh vertices to the tracked features.
#
# Symmetrised medians over the same ten people of the constant offsets that explain the tracked points in
# the left images, given true poses and vertices. They are not recomputed when a person is left out.
SEEN_BESIDE = _both_sides(
    [(-0.5, 0.3, 2.2), (-0.8, -0.1, 2.0), (0.1, -0.3, 0.9), (-2.1, 2.8, 3.8), (-3.7, -6.2, -2.1)]
)

NEUTRAL: Expression = {}
SIDEWAYS: Mapping[float, Expression] = {
    0.0: {"mouthPucker": 1.0},
    0.5: NEUTRAL,
    1.0: {"mouthSmile": 0.7, "mouthStretch": 0.3},
}
# Strengths of the published expressions by rate of a motion, interpolated linearly. The brows move before
# the jaw, so that the model can separate the two.
VERTICAL: Mapping[float, Expression] = {
    0.0: {"browDown": 1.0},
    0.25: NEUTRAL,
    0.5: {"browInnerUp": 1.0},
    1.0: {"browInnerUp": 1.0, "jawOpen": 1.0},
}
RATES = np.linspace(0.0, 1.0, 5)


@dataclass(frozen=True, eq=False)
class Statistics:
    """Published statistics of the ten points."""

    mean: FloatArray  # (K, 3) mean neutral face, mm, made symmetric
    modes: FloatArray  # (M, K, 3) of identity, one standard deviation each, mm
    expressions: Mapping[str, FloatArray]  # displacements (K, 3) at full strength by name, mm

    def people(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw neutral faces and their negatives (2 count, K, 3), mm, about the mean of the eye corners."""
        drawn = rng.standard_normal((count, len(self.modes)))
        people = self.mean + np.tensordot(np.concatenate([drawn, -drawn]), self.modes, axes=1)
        centred: FloatArray = people - people[:, EYES].mean(axis=1, keepdims=True)
        return centred

    def face(self, expression: Expression) -> FloatArray:
        """Return the displacement (K, 3) of several expressions, mm, applied to both sides."""
        total = np.zeros_like(self.mean)
        for name, strength in expression.items():
            sides = [name] if name in self.expressions else [f"{name}_L", f"{name}_R"]
            total = total + strength * sum(self.expressions[side] for side in sides)
        return total


def read_statistics(path: Path) -> Statistics:
    """Read the file of statistics."""
    contents = json.loads(path.read_text(encoding="utf-8"))
    if tuple(contents["points"]) != POINT_NAMES:
        raise click.ClickException(f"{path}: other feature points, expected {', '.join(POINT_NAMES)}")
    mean, modes = np.array(contents["mean"]), contents["identity_modes"]
    deviations = np.array(modes["standard_deviation"])
    expressions = {name: np.array(moved) for name, moved in contents["expressions"].items()}
    return Statistics(
        0.5 * (mean + mirrored(mean)), np.array(modes["direction"]) * deviations[:, None, None], expressions
    )


def measured_offsets(statistics: Statistics, people: Sequence[Path]) -> FloatArray:
    """Return (K, 3) mm: the symmetrised mean neutral face of people minus that of the statistics."""
    faces = []
    for folder in people:
        truth = load_csv_track(folder / TRUTH, head_subject("left", 0))
        assert truth.points is not None and truth.position is not None and truth.quaternion is not None
        repeated = (
            np.repeat(one[:1], len(POINT_NAMES), axis=0) for one in (truth.position, truth.quaternion)
        )
        face = in_object(truth.points[0], *repeated)
        faces.append(face - face[EYES].mean(axis=0) + SEEN_BESIDE)
    mean = np.mean(faces, axis=0)
    offsets: FloatArray = 0.5 * (mean + mirrored(mean)) - statistics.mean
    return offsets


def build(statistics: Statistics, offsets: FloatArray = FEATURE_OFFSETS) -> BuiltModel:
    """Build the model from people with all expressions, scaled by the width of the face.

    Faces are built from symmetric halves, so a sideways motion of the mouth is added; otherwise it would be
    explained by a rotation of the head.
    """
    people = statistics.people(PEOPLE, np.random.default_rng(SEED))
    actions = [motion(statistics, knots, rate) for knots in (SIDEWAYS, VERTICAL) for rate in RATES]
    widths, width = (
        np.linalg.norm(faces[..., EYES.stop - 1, :] - faces[..., EYES.start, :], axis=-1)
        for faces in (people, statistics.mean)
    )
    widths = widths / width  # between the outer eye corners
    features = people + offsets
    built = build_model(features[:, None] + widths[:, None, None, None] * np.stack(actions))
    sizes = np.tile(widths, 2)  # of the right halves, then of the left
    return add_deformation(built, displacement("mouth_left"), sizes, USUAL)


def motion(statistics: Statistics, knots: Mapping[float, Expression], rate: float) -> FloatArray:
    """Return the displacement (K, 3) of a motion at a rate from 0 to 1, mm."""
    shares = [np.interp(rate, list(knots), row) for row in np.eye(len(knots))]
    moved = [share * statistics.face(knot) for share, knot in zip(shares, knots.values(), strict=True)]
    total: FloatArray = np.sum(moved, axis=0)
    return total


@click.command(help=__doc__)
@click.argument("statistics", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("people", nargs=-1, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--without", multiple=True, help="Leave out the person of this name. Repeatable.")
@click.option("--out", default=SHIPPED, type=click.Path(dir_okay=False, path_type=Path))
def main(statistics: Path, people: tuple[Path, ...], without: tuple[str, ...], out: Path) -> None:
    """Write the model and print its approximation error.

    Feature offsets are the mean over PEOPLE, folders of recordings with truth.csv; without any,
    ``FEATURE_OFFSETS``.
    """
    read, used = read_statistics(statistics), [one for one in people if one.name not in without]
    built = build(read, measured_offsets(read, used) if used else FEATURE_OFFSETS)
    parts = {part.name: getattr(built.model, part.name) for part in fields(built.model)}
    model = FaceModel(**{name: np.round(values, DECIMALS) for name, values in parts.items()})
    save_face_model(out, model, SOURCE)
    errors = np.linalg.norm(built.approximations() - built.samples, axis=-1)
    print(f"{out}: rms {np.sqrt(np.mean(errors**2)):.3f} mm over {len(built.samples)} half faces")


if __name__ == "__main__":
    main()
