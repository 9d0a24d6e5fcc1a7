"""Learn mean and modes of hands from GLB files of people with WebXR joint names.

All meshes must have the same triangles in the same order, as reshaped copies of one rig.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.cli.terminal import bar
from posetrack_cli.hand.model.anatomy import COEFFICIENTS, SHIPPED, Population, RestHand, rest_rotations
from posetrack_cli.outputs import whole_or_nothing
from posetrack_cli.rendering.mesh import smoothing
from research.hand_model.people import rows
from research.hand_model.template import adult, cage_of

# Weight of a bone length against one coordinate of the skin; the modes must explain both
BONE_WEIGHT = 4.0
_BONES = 30  # values after those of the cage: bases and segments
_RADII = 20
_DIGITS = 6
_LAST = np.arange(-_RADII - 15, -_RADII)[2::3]  # where a hand's row has the fingers' last segments


def modes_of(hands: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return mean (D,) and strongest modes (count, D) of hands (N, D), scaled by standard deviation."""
    weights = np.ones(hands.shape[1])
    weights[-_BONES - _RADII : -_RADII] = BONE_WEIGHT
    mean = hands.mean(axis=0)
    _, s, vt = np.linalg.svd((hands - mean) * weights, full_matrices=False)
    modes = vt[:count] * (s[:count, None] / np.sqrt(len(hands) - 1.0)) / weights
    strongest = np.take_along_axis(modes, np.abs(modes).argmax(axis=1)[:, None], axis=1)
    return mean, modes * np.sign(strongest)


def with_tips_in_the_skin(people: Population) -> Population:
    """Return hands whose last finger segments end at the end of the tracked skin.

    The registered template rounds off fingertips, so the tips of the meshes would stick out of it by 0.5 to
    1.9 mm. Modes move the tips like the ends of the skin, to first order.
    """
    smooth = smoothing(people.triangles, 1)
    skin = _Smooth(smooth.through, np.asarray(smooth.blend @ people.weights))
    mean, modes = people.mean.copy(), people.modes.copy()
    mean[_LAST] = _last_segments(people.hand(), skin)
    for k in range(len(modes)):
        more, less = (_last_segments(people.hand([0.0] * k + [way]), skin) for way in (1.0, -1.0))
        modes[k, _LAST] = 0.5 * (more - less)
    return replace(people, mean=mean, modes=modes)


class _Smooth(NamedTuple):
    """The tracked surface: subdivision ``through`` (V, C) of a cage, and skin ``weights`` (V, 16)."""

    through: FloatArray
    weights: FloatArray


def _last_segments(hand: RestHand, skin: _Smooth) -> FloatArray:
    """Return the distances (5,) from joints 1 to the end of the smooth skin, thumb first, mm."""
    vertices, outwards = skin.through @ hand.cage, -rest_rotations()[:, :, 1]
    reaches: FloatArray = np.empty(len(outwards))
    for finger, (outward, base) in enumerate(zip(outwards, hand.bases, strict=True)):
        own = skin.weights[:, 3 + 3 * finger] > 0.5
        reaches[finger] = np.max((vertices[own] - base) @ outward)
    lasts: FloatArray = reaches - hand.segments[:, :2].sum(axis=1)
    return lasts


@click.command()
@click.argument("people", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option(
    "-o", "--output", default=SHIPPED, show_default="the one shipped", type=click.Path(path_type=Path)
)
def main(people: tuple[Path, ...], output: Path) -> None:
    """Learn mean and modes from PEOPLE, GLB files or folders of them, and write them."""
    files = sorted(path for one in people for path in (one.rglob("*.glb") if one.is_dir() else [one]))
    found = []
    with bar("build", "hand", len(files)) as shown:
        for row in rows(files):
            found.append(row)
            shown.advance()
    hands = np.array(found)
    mean, modes = modes_of(hands, COEFFICIENTS)
    cage = cage_of(adult())
    write(with_tips_in_the_skin(Population(mean, modes, cage.weights, cage.triangles)), output)
    rest = hands - mean
    unexplained = rest - rest @ np.linalg.pinv(modes) @ modes
    skin = unexplained[:, : -_BONES - _RADII].reshape(len(hands), -1, 3)
    bones = unexplained[:, -_BONES - _RADII : -_RADII]
    click.echo(
        f"{output}: {len(hands)} hands, {COEFFICIENTS} modes leave"
        f" {np.sqrt((skin**2).sum(axis=2).mean()):.2f} mm of skin, {np.sqrt((bones**2).mean()):.2f} of bones"
    )


def write(people: Population, output: Path) -> None:
    """Write hands in the format of ``population.npz``."""
    with whole_or_nothing(output) as part, part.open("wb") as stream:
        np.savez_compressed(
            stream,
            mean=_rounded(people.mean),
            modes=_rounded(people.modes),
            weights=_rounded(people.weights),
            triangles=people.triangles.astype(np.int16),
        )


def _rounded(values: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Round off the last bits, which differ between machines."""
    return np.round(values, _DIGITS).astype(np.float32)


if __name__ == "__main__":
    main()
