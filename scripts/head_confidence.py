"""What the confidence of heads is made from: harder recordings, and the regression's weights.

``harden`` makes a recording with truth harder, as both right and wrong frames are needed. ``fit`` reads
results with their truth and tells the weights of ``head.tracker.confidence``, and what they are worth on
people they were not fitted to: each person, in all recordings, is left out in turn. Real heads count a
quarter of rendered ones, however many recordings there are of either, as their references err. Results of
two cameras, of one, and of one that knew the skin have weights of their own.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray
from posetrack_cli.evaluation.honesty import calibration_error, reliability, roc_area
from posetrack_cli.evaluation.subjects.head import FAR_DEG
from posetrack_cli.head.subject import RIGHT_DEG, RIGHT_MM, SIGN_NAMES
from posetrack_cli.results import load_arrays, read_result
from posetrack_cli.tracking.confidence import Regression
from reproduction.heads_data import CALIBRATION, TRUTH
from reproduction.one_camera.measuring import Compared, compare
from reproduction.regression import AGAINST, left_out, regression_of

REDUCED = 0.3
"""Of a small image's width beside the recorded one's: eyes some 27 pixels apart."""
COVER_PX, COVER_FROM = (110, 90), 15
"""Height and width of what passes before the face, and the first frame with it."""
USUAL_WEIGHT = 4.0
"""A recording as it is counts as so many hardened ones."""
USUAL, REAL = "+", "~"
REAL_SHARE = 0.25
"""Of real recordings beside rendered ones."""
UNSURE_DEG, UNSURE_MM = 3.0, 1.0
"""A reference of a real recording, points of another detector and the pose that they tell, errs as much
itself: frames that are off by this and twice this more than what is right are neither right nor wrong."""


def _small(images: Sequence[ImageArray], index: int, rng: np.random.Generator) -> ImageArray:
    return _grey(cv2.resize(images[index], None, fx=REDUCED, fy=REDUCED, interpolation=cv2.INTER_AREA))


def _blurred(images: Sequence[ImageArray], index: int, rng: np.random.Generator) -> ImageArray:
    last = len(images) - 1
    near = [images[min(max(index + step, 0), last)].astype(np.float64) for step in (-1, 0, 1)]
    return _grey(np.mean(near, axis=0))


def _covered(images: Sequence[ImageArray], index: int, rng: np.random.Generator) -> ImageArray:
    """A blurred noise passes before the face three times, at three heights."""
    image = images[index].copy()
    if index < COVER_FROM:
        return image
    height, width = image.shape
    noise = cv2.GaussianBlur(
        np.random.default_rng(0).integers(0, 255, image.shape).astype(np.uint8), (0, 0), 6
    )
    noise = cv2.normalize(noise, np.empty_like(noise), 40, 170, cv2.NORM_MINMAX)
    left = int(width * (0.15 + 0.7 * (3.0 * index / len(images) % 1.0)))
    top = int(height * (0.25 + 0.175 * (index // 40 % 3)))
    where = (slice(top, top + COVER_PX[0]), slice(left, left + COVER_PX[1]))
    image[where] = noise[where]
    return image


def _dark(images: Sequence[ImageArray], index: int, rng: np.random.Generator) -> ImageArray:
    grey = 40.0 + 0.28 * (images[index].astype(np.float64) - 40.0)
    return _grey(grey + rng.normal(0.0, 7.0, grey.shape) + 18.0 * np.sin(index / 11.0))


def _grey(image: Any) -> ImageArray:
    clipped: ImageArray = np.clip(image, 0, 255).astype(np.uint8)
    return clipped


KINDS: dict[str, Callable[[Sequence[ImageArray], int, np.random.Generator], ImageArray]] = {
    "small": _small,
    "blurred": _blurred,
    "covered": _covered,
    "dark": _dark,
}


def harden(recording: Path, output: Path, kind: str) -> None:
    """Write a study recording (images of each camera, calibration.json, truth.csv) made harder."""
    calibration = json.loads((recording / CALIBRATION).read_text())
    for name, camera in calibration["cameras"].items():
        images = [
            _grey(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
            for path in sorted((recording / name).iterdir())
        ]
        (output / name).mkdir(parents=True, exist_ok=True)
        rng = np.random.default_rng(len(name))
        for index in range(len(images)):
            harder = KINDS[kind](images, index, rng)
            cv2.imwrite(str(output / name / f"{index:06d}.png"), harder)
        if kind == "small":
            matrix = np.array(camera["K"], dtype=float)
            matrix[:2] *= REDUCED
            camera |= {"K": matrix.tolist(), "height": harder.shape[0], "width": harder.shape[1]}
    (output / CALIBRATION).write_text(json.dumps(calibration))
    shutil.copyfile(recording / TRUTH, output / TRUTH)


@dataclass(frozen=True, eq=False)
class Frames:
    """The frames of a result in which a head was followed, whether it says so or not.

    Attributes:
        person: who it is of.
        weight: of the recording.
        signs: (M, S).
        right: (M,) whether rotation and points are right.
        turned_right: (M,) whether the rotation is.
        far: (M,) whether it is off by more than 10 degrees.
        is_real: whether a camera recorded it.
    """

    person: str
    weight: float
    signs: FloatArray
    right: BoolArray
    turned_right: BoolArray
    far: BoolArray
    is_real: bool = False


def read_frames(
    person: str, result: Path, truth: Path | None, weight: float, *, is_real: bool = False
) -> Frames:
    """Read a result, and compare it with a truth; None for the truth that it carries.

    Errors are those beside constant offsets: of the head's frame, and of each point in it. Of a real
    recording the truth is a reference that is unsure itself.
    """
    one, numbers = compare(result, truth), read_result(result).numbers()
    signs = np.stack([np.asarray(numbers[name]) for name in SIGN_NAMES], axis=1)
    stamps = np.asarray(load_arrays(result)["stamp_ns"])
    signs = signs[np.searchsorted(stamps, np.asarray(one.track.stamp_ns))]
    turned, right = _are_right(one, float(is_real))
    _, nearly = _are_right(one, 2.0 * is_real)
    chosen = np.isfinite(signs).all(axis=1) & (right | ~nearly)
    far = one.rotation_deg > FAR_DEG
    return Frames(person, weight, signs[chosen], right[chosen], turned[chosen], far[chosen], is_real)


def _are_right(one: Compared, unsure: float) -> tuple[BoolArray, BoolArray]:
    """Whether rotations (M,) are right, and points (M,), too, to so many errors of a reference."""
    turned = one.rotation_deg <= RIGHT_DEG + unsure * UNSURE_DEG
    return turned, turned & (one.shapes_mm.mean(axis=1) <= RIGHT_MM + unsure * UNSURE_MM)


def fitted(frames: Sequence[Frames]) -> Regression:
    """Return the regression of most likelihood: recordings count by their weights, real ones a quarter.

    Every sign speaks against a frame or not at all: a weight above 0 would be of these people alone.
    """
    bounds = [AGAINST] * len(SIGN_NAMES)
    return regression_of(frames, [one.weight for one in frames], REAL_SHARE, bounds)


def report(frames: Sequence[Frames]) -> list[str]:
    """Return the weights in words, and what they are worth on people they were not fitted to."""
    stated, final = left_out(frames, fitted), fitted(frames)
    usual, real = [one.weight > 1.0 for one in frames], [one.is_real for one in frames]
    lines = [f"bias {final.bias:.2f}, weights {', '.join(f'{w:.2f}' for w in final.weights)}"]
    for what, chosen in (("recordings as they are", usual), ("real", real), ("all", [True] * len(frames))):
        if not any(chosen):
            continue
        p = np.concatenate([s for s, c in zip(stated, chosen, strict=True) if c])
        right, turned, far = (
            np.concatenate([getattr(one, name) for one, c in zip(frames, chosen, strict=True) if c])
            for name in ("right", "turned_right", "far")
        )
        bins = reliability(p, right)
        lines += [
            f"{what}: {len(p)} frames, {right.mean():.1%} right; ROC area {roc_area(p, right):.3f}, of the"
            f" rotation {roc_area(p, turned):.3f}; calibration error {calibration_error(bins):.3f}; below .5"
            f" {np.mean(p < 0.5):.1%}; off by 10 deg {far.mean():.2%}, and above .5"
            f" {np.mean(far & (p >= 0.5)):.2%}",
            *(
                f"  {one.confidence:.2f} said, {one.right:.2f} right, {one.count} frames"
                for one in bins
                if one.count
            ),
        ]
    return lines


@click.group(help=__doc__)
def main() -> None:
    """Hold the commands."""


@main.command("harden")
@click.argument("recording", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("output", type=click.Path(path_type=Path))
@click.option("--kind", type=click.Choice(list(KINDS)), required=True)
def harden_command(recording: Path, output: Path, kind: str) -> None:
    """Make RECORDING harder: smaller, blurred (track every third frame, too), covered or dark."""
    harden(recording, output, kind)


@main.command("fit")
@click.argument("results", nargs=-1, required=True)
def fit_command(results: tuple[str, ...]) -> None:
    """Fit to RESULTS, each PERSON,RESULT[,TRUTH].

    PERSON+ for a recording that is not hardened, PERSON~ for a real one with a reference.
    """
    frames = []
    for one in results:
        person, result, *truth = one.split(",")
        name, kind = person.rstrip(USUAL + REAL), person[-1]
        told = Path(truth[0]) if truth else None
        weight = USUAL_WEIGHT if kind == USUAL else 1.0
        frames.append(read_frames(name, Path(result), told, weight, is_real=kind == REAL))
    print("\n".join(report(frames)))


if __name__ == "__main__":
    main()
