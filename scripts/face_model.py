"""The face model that is shipped: faces and expressions drawn from statistics of ICT-FaceKit.

ICT-FaceKit is a model of faces of the USC Institute for Creative Technologies (MIT licence). The
statistics are mean, identity modes and expressions of the ten feature points, mm in the head's frame.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import click
import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face.points import EYES, POINT_NAMES
from posetrack_cli.head.multilinear.build import BuiltModel, build_model, mirrored
from posetrack_cli.head.multilinear.face_model import SHIPPED, FaceModel, save_face_model

SOURCE = "statistics of ICT-FaceKit (USC Institute for Creative Technologies, MIT licence)"
PEOPLE, SEED = 60, 1
"""How many identities are drawn; each one's negative is another."""
DECIMALS = 9
"""To which the arrays are rounded, so that the last bits of a machine's arithmetic do not show."""
Expression = Mapping[str, float]

FEATURE_OFFSETS = np.array(
    [
        [-2.1, 1.8, 2.2],
        [-2.0, 1.7, 1.5],
        [2.0, 1.7, 1.5],
        [2.1, 1.8, 2.2],
        [-1.1, 1.2, 1.2],
        [1.1, 1.2, 1.2],
        [-1.5, 5.3, 11.0],
        [1.5, 5.3, 11.0],
        [-6.1, -10.3, 7.0],
        [6.1, -10.3, 7.0],
    ]
)
"""(K, 3) mm, how far the image features that a tracker follows lie from the statistics' landmarks **[ours]**.

A tracker sees the outer end of the lids' shadow, a nostril's dark opening, the brow's dark inner end; the
landmarks are vertices of a mesh. The figures are what stereo tracking measured of two people with known
vertices (the recordings person-a and person-b of the study), averaged and made symmetric; of the brows,
whose vertices are others there, against the mean face. A model built from results of tracking needs none.
"""

NEUTRAL: Expression = {}
SIDEWAYS: Mapping[float, Expression] = {
    0.0: {"mouthPucker": 1.0},
    0.5: NEUTRAL,
    1.0: {"mouthSmile": 0.7, "mouthStretch": 0.3},
}
VERTICAL: Mapping[float, Expression] = {
    0.0: {"browDown": 1.0},
    0.25: NEUTRAL,
    0.5: {"browInnerUp": 1.0},
    1.0: {"browInnerUp": 1.0, "jawOpen": 1.0},
}
"""Strengths of the published expressions at some rates of a motion; between them they change linearly.

The brows go before the jaw, so that the model can tell one from the other."""
RATES = np.linspace(0.0, 1.0, 5)


@dataclass(frozen=True, eq=False)
class Statistics:
    """What is published of the ten points.

    Attributes:
        mean: (K, 3) mean neutral face, mm, made symmetric.
        modes: (M, K, 3) of identity, one standard deviation each, mm.
        expressions: displacements (K, 3) at full strength by name, mm.
    """

    mean: FloatArray
    modes: FloatArray
    expressions: Mapping[str, FloatArray]

    def people(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw neutral faces and their negatives (2 count, K, 3), mm, about the mean of the eye corners."""
        drawn = rng.standard_normal((count, len(self.modes)))
        people = self.mean + np.tensordot(np.concatenate([drawn, -drawn]), self.modes, axes=1)
        centred: FloatArray = people - people[:, EYES].mean(axis=1, keepdims=True)
        return centred

    def face(self, expression: Expression) -> FloatArray:
        """Return the displacement (K, 3) of several expressions, mm; those of one side are used on both."""
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


def build(statistics: Statistics) -> BuiltModel:
    """Build the model of people who each do everything; expressions grow with the width of the face."""
    people = statistics.people(PEOPLE, np.random.default_rng(SEED))
    actions = [motion(statistics, knots, rate) for knots in (SIDEWAYS, VERTICAL) for rate in RATES]
    widths = _width(people) / _width(statistics.mean)
    features = people + FEATURE_OFFSETS
    return build_model(features[:, None] + widths[:, None, None, None] * np.stack(actions))


def motion(statistics: Statistics, knots: Mapping[float, Expression], rate: float) -> FloatArray:
    """Return the displacement (K, 3) of a motion at a rate from 0 to 1, mm."""
    shares = [np.interp(rate, list(knots), row) for row in np.eye(len(knots))]
    moved = [share * statistics.face(knot) for share, knot in zip(shares, knots.values(), strict=True)]
    total: FloatArray = np.sum(moved, axis=0)
    return total


def _width(faces: FloatArray) -> FloatArray:
    """Distance (...) of the outer eye corners."""
    width: FloatArray = np.linalg.norm(faces[..., EYES.stop - 1, :] - faces[..., EYES.start, :], axis=-1)
    return width


def _rounded(model: FaceModel) -> FaceModel:
    return FaceModel(**{part.name: np.round(getattr(model, part.name), DECIMALS) for part in fields(model)})


@click.command(help=__doc__)
@click.argument("statistics", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("out", type=click.Path(dir_okay=False, path_type=Path), default=SHIPPED)
def main(statistics: Path, out: Path) -> None:
    """Write the model, and say how near it comes to the faces that it was built from."""
    built = build(read_statistics(statistics))
    save_face_model(out, _rounded(built.model), SOURCE)
    errors = np.linalg.norm(built.approximations() - built.samples, axis=-1)
    print(f"{out}: rms {np.sqrt(np.mean(errors**2)):.3f} mm over {len(built.samples)} half faces")


if __name__ == "__main__":
    main()
