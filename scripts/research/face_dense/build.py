"""Build the networks and expressions of the dense face from rendered faces of ICT-FaceKit.

ICT-FaceKit is a face model of the USC Institute for Creative Technologies (MIT licence). The results contain
trained weights and mean displacements, no geometry and no image. The shipped networks were trained in rounds
of these steps: on 800 people, and then on 220 more with more beards; the network of gazes at last, on
300 rendered and 120 drawn people.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.head.dense import expressions, network
from posetrack_cli.head.dense.expressions import BLEND_SHAPES
from posetrack_cli.head.dense.network import EYE_NETWORK, GAZE_NETWORK, MOUTH_NETWORK
from posetrack_cli.head.dense.points import (
    DENSE_COUNT,
    EYE_POINTS,
    LEFT_IRIS,
    MOUTH_POINTS,
    NUMBERS,
    RIGHT_IRIS,
)
from research.face_dense.drawn import draw_gazes
from research.face_dense.mesh import LANDMARKS, FaceKit, read_face_kit
from research.face_dense.samples import GazeSample, Samples, draw_samples, joined, kit_gazes

PEOPLE, PEOPLE_PER_PART, CHECKED_PEOPLE = 800, 100, 40
GAZE_PEOPLE, DRAWN_PEOPLE, DRAWN_CHECKED = 300, 120, 10
"""People whose gaze is learned, of ICT-FaceKit and as ``head synth`` draws them."""
SEED = 1
MOUTH_PAIRS = ((62, 66), (61, 67), (63, 65), (51, 57), (48, 54), (60, 64))
EYE_PAIRS = ((37, 41), (38, 40), (36, 39))
"""Pairs of points whose distance matters."""
_MIRRORED = {number: 16 - number for number in range(17)} | {
    a: b
    for first, second in (
        ((31, 32, 33), (35, 34, 33)),
        ((48, 49, 50, 51, 59, 58, 57), (54, 53, 52, 51, 55, 56, 57)),
        ((60, 61, 62, 67, 66), (64, 63, 62, 65, 66)),
    )
    for one, other in zip(first, second, strict=True)
    for a, b in ((one, other), (other, one))
}


def expression_displacements(kit: FaceKit) -> FloatArray:
    """Return the displacements (E, D, 3), mm, of the dense points at full strength; zero for irises."""
    found = np.zeros((len(BLEND_SHAPES), DENSE_COUNT, 3))
    on_mesh = np.array([number not in (RIGHT_IRIS, LEFT_IRIS) for number in NUMBERS])
    vertices = LANDMARKS[[number for number in NUMBERS if number < len(LANDMARKS)]]
    for row, name in enumerate(BLEND_SHAPES):
        for kit_name, moved in kit.expressions.items():
            if kit_name.replace("_L", "Left").replace("_R", "Right") == name or (
                name == "browInnerUp" and kit_name.startswith(name)
            ):
                found[row, on_mesh] += moved[vertices]
    return found


def _part(job: tuple[FaceKit, int]) -> dict[str, Samples]:
    kit, part = job
    return draw_samples(kit, PEOPLE_PER_PART if part else CHECKED_PEOPLE, part)


def gaze_arrays(kit: FaceKit) -> dict[str, FloatArray]:
    """Train the network of gazes on rendered and drawn people; return its arrays."""
    from research.face_dense.training import gaze_spread, train_gaze, weights_of

    crops, gazes = arrays_of([*kit_gazes(kit, GAZE_PEOPLE, 1), *draw_gazes(DRAWN_PEOPLE, 1)])
    checked, true = arrays_of([*kit_gazes(kit, CHECKED_PEOPLE, 0), *draw_gazes(DRAWN_CHECKED, 0)])
    trained = train_gaze(crops, gazes, SEED)
    return weights_of(trained, checked) | {"spread": gaze_spread(trained, checked, true)}


def arrays_of(samples: Sequence[GazeSample]) -> tuple[ImageArray, FloatArray]:
    """Return the crops (N, height, width) and gazes (N, 2) of samples."""
    return np.array([one.crop for one in samples]), np.array([one.gaze for one in samples])


@click.command()
@click.argument("face_kit", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), default=network.SHIPPED.parent)
def build(face_kit: Path, out: Path) -> None:
    """Draw faces of FACE_KIT, a checkout of ICT-FaceKit, and train the networks in about half an hour.

    PyTorch must be installed in .venv; nothing else needs it.
    """
    from research.face_dense.training import spread_of, train, weights_of

    kit = read_face_kit(face_kit)
    out.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        out / expressions.SHIPPED.name, displacements=expression_displacements(kit).astype(np.float32)
    )
    parts = PEOPLE // PEOPLE_PER_PART
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        drawn = pool.map(_part, [(kit, part) for part in range(parts + 1)])
    checked, learned = drawn[0], {name: joined([part[name] for part in drawn[1:]]) for name in drawn[0]}
    arrays: dict[str, Any] = {}
    for name, numbers, pairs in (
        (MOUTH_NETWORK, MOUTH_POINTS, MOUTH_PAIRS),
        (EYE_NETWORK, EYE_POINTS[0], EYE_PAIRS),
    ):
        rows = [(numbers.index(a), numbers.index(b)) for a, b in pairs]
        mirrored = [numbers.index(_MIRRORED[one]) for one in numbers] if name == MOUTH_NETWORK else None
        trained = train(learned[name], rows, mirrored, SEED)
        found = weights_of(trained, checked[name].crops) | {"spread": spread_of(trained, checked[name])}
        arrays |= {f"{name}.{key}": array for key, array in found.items()}
    gaze = gaze_arrays(kit)
    arrays |= {f"{GAZE_NETWORK}.{key}": array for key, array in gaze.items()}
    np.savez_compressed(out / network.SHIPPED.name, **arrays)


if __name__ == "__main__":
    build()
