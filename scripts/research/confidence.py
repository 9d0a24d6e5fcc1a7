"""Fit the confidence of hands and heads to results with truth, and make recordings of heads harder for it.

Confidence is made from a result's ``sign_...`` numbers. Printed are the weights of ``hand.confidence`` or
``head.tracker.frame_tracker`` that fit them best, and what these are worth on people that they were not
fitted to: each person, in all recordings, is left out in turn.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click
import cv2
import numpy as np
from scipy.optimize import minimize

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions
from posetrack_cli.evaluation.measuring.honesty import calibration_error, reliability, roc_area
from posetrack_cli.evaluation.measuring.subjects.hand import FAR_MM
from posetrack_cli.evaluation.measuring.subjects.head import FAR_DEG
from posetrack_cli.hand import confidence as of_hands
from posetrack_cli.head import subject as of_heads
from posetrack_cli.results import load_arrays, read_result
from posetrack_cli.tracking.confidence import PROBABLY, Regression
from research import hands
from research.heads import CALIBRATION, TRUTH, compare

Bounds = tuple[float | None, float | None]
PENALTY = 1e-3  # of the squares of weights, in units of the signs' deviations
AGAINST: Bounds = (None, 0.0)
FOR: Bounds = (0.0, None)  # of the weight of a sign that can only speak against a frame, or for it
HAND_BOUNDS = (AGAINST, AGAINST, AGAINST, FOR, AGAINST)
"""Costs, innovation and alternatives speak against a frame, contrast for it."""
HEAD_BOUNDS = [AGAINST] * len(of_heads.SIGN_NAMES)
"""A head's signs all speak against a frame: a weight above 0 would be of these people alone."""
HAND_REAL_SHARE, HEAD_REAL_SHARE = 1.0, 0.25
"""Weight of real recordings against rendered ones, all together; references of real heads err."""
USUAL_WEIGHT = 4.0  # a head's recording as it is counts as so many hardened ones
UNSURE_DEG, UNSURE_MM = 3.0, 1.0
"""Error of a real head's reference: frames off by once to twice this more than right are left out."""
OFFSETS, USUAL, REAL = "*", "+", "~"


class Frames(NamedTuple):
    """The M frames of a result in which something was followed, whether it is lost or not."""

    person: str
    signs: FloatArray  # (M, S)
    right: BoolArray  # (M,) whether the estimate is
    far: BoolArray  # (M,) whether it is far off
    is_real: bool = False  # whether a sensor recorded it
    weight: float = 1.0  # of the recording among those of its kind


def signs_of(result: Path, names: Sequence[str]) -> FloatArray:
    """Return the signs (M, S) of all frames of a result; NaN where it has none."""
    numbers = read_result(result).numbers()
    return np.stack([np.asarray(numbers[name]) for name in names], axis=1)


def hand_frames(person: str, result: Path, *judged: str) -> Frames:
    """Read a hand's result.

    Args:
        person: with ``OFFSETS`` at the end for joints that are marked by another convention.
        result: that carries its truth.
        judged: instead of a truth, numbers of frames that look right, and of wrong ones, such as ``0-8-16``.
    """
    name, is_real = person.removesuffix(OFFSETS), person.endswith(OFFSETS)
    signs = signs_of(result, of_hands.SIGN_NAMES)
    if judged:
        right, wrong = ([int(k) for k in some.split("-") if k] for some in judged)
        is_right = np.arange(len(right) + len(wrong)) < len(right)
        return Frames(name, signs[right + wrong], is_right, np.zeros_like(is_right), is_real=True)
    found = hands.evaluated(result, EvalOptions(joint_offsets="bone" if is_real else None))
    frames = hands.frames_of(found)
    if frames is None or found.pairs is None:
        raise click.ClickException(f"{result}: no truth with a wrist")
    signs = signs[found.pairs.estimate]
    seen = np.isfinite(signs).all(axis=1)
    error = frames.error[seen]
    return Frames(name, signs[seen], error < of_hands.RIGHT_MM, error > FAR_MM, is_real)


def head_frames(person: str, result: Path, truth: Path | None = None) -> Frames:
    """Read a head's result, and compare it with a truth; None for the truth that it carries.

    Errors are those after constant offsets: of the head's frame, and of each point in it.

    Args:
        person: with ``USUAL`` at the end for a recording that is not hardened, ``REAL`` for a real one, whose
            truth is a reference that errs itself.
        result: of ``posetrack head``.
        truth: a file.
    """
    one, is_real = compare(result, truth), person.endswith(REAL)
    shapes = one.points_mm()[1].mean(axis=1)

    def within(unsure: float) -> BoolArray:
        """Whether rotations and points (M,) are right, to so many errors of a reference."""
        turned = one.rotation_deg <= of_heads.RIGHT_DEG + unsure * UNSURE_DEG
        found: BoolArray = turned & (shapes <= of_heads.RIGHT_MM + unsure * UNSURE_MM)
        return found

    signs = signs_of(result, of_heads.SIGN_NAMES)
    stamps = np.asarray(load_arrays(result)["stamp_ns"])
    signs = signs[np.searchsorted(stamps, one.stamp_ns)]
    right, nearly = (within(factor * is_real) for factor in (1.0, 2.0))
    chosen = np.isfinite(signs).all(axis=1) & (right | ~nearly)
    far, weight = one.rotation_deg > FAR_DEG, USUAL_WEIGHT if person.endswith(USUAL) else 1.0
    return Frames(person.rstrip(USUAL + REAL), signs[chosen], right[chosen], far[chosen], is_real, weight)


def fitted(frames: Sequence[Frames], real_share: float, bounds: Sequence[Bounds]) -> Regression:
    """Return the regression of most likelihood, whose signs' weights have bounds.

    Recordings count by their weights, however many frames they have, and real ones by ``real_share`` against
    all others.
    """
    whole = {kind: sum(one.weight for one in frames if one.is_real == kind) for kind in (False, True)}
    shares = (one.weight / whole[one.is_real] * (real_share if one.is_real else 1.0) for one in frames)
    counts = [
        np.full(len(one.right), share / max(len(one.right), 1))
        for one, share in zip(frames, shares, strict=True)
    ]
    signs, right = (np.concatenate([getattr(one, name) for one in frames]) for name in ("signs", "right"))
    weights = np.concatenate(counts)
    weights /= weights.sum()
    mean, sd = weights @ signs, signs.std(axis=0) + 1e-9
    design = np.column_stack([np.ones(len(signs)), (signs - mean) / sd])

    def cost(w: FloatArray) -> tuple[float, FloatArray]:
        logit = design @ w
        missing = weights * (1.0 / (1.0 + np.exp(-logit)) - right)
        penalty = np.concatenate([[0.0], 2.0 * PENALTY * w[1:]])
        value = weights @ (np.logaddexp(0.0, logit) - right * logit) + PENALTY * w[1:] @ w[1:]
        return float(value), missing @ design + penalty

    start = np.zeros(design.shape[1])
    w = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=[(None, None), *bounds]).x
    return Regression(float(w[0] - (w[1:] / sd) @ mean), w[1:] / sd)


def report(frames: Sequence[Frames], real_share: float, bounds: Sequence[Bounds]) -> list[str]:
    """Return the weights in words, and what they are worth on people they were not fitted to."""
    final = fitted(frames, real_share, bounds)
    probabilities = []
    for one in frames:
        others = fitted([other for other in frames if other.person != one.person], real_share, bounds)
        probabilities.append(np.array([others.probability(signs) for signs in one.signs]))
    groups = {"all": list(range(len(frames)))}
    groups["recordings as they are"] = [k for k, one in enumerate(frames) if one.weight > 1.0]
    groups["real"] = [k for k, one in enumerate(frames) if one.is_real]
    groups |= {
        name: [k for k, one in enumerate(frames) if one.person == name]
        for name in sorted({one.person for one in frames})
    }
    lines = [f"bias {final.bias:.2f}, weights {', '.join(f'{w:.2f}' for w in final.weights)}"]
    for name, chosen in ((name, chosen) for name, chosen in groups.items() if chosen):
        p = np.concatenate([probabilities[k] for k in chosen])
        right, far = (np.concatenate([getattr(frames[k], what) for k in chosen]) for what in ("right", "far"))
        bins = reliability(p, right)
        lines.append(
            f"{name}: {len(p)} frames, {right.mean():.1%} right; ROC area {roc_area(p, right):.3f}; "
            f"calibration error {calibration_error(bins):.3f}; below {PROBABLY:g} "
            f"{np.mean(p < PROBABLY):.1%}; far {far.mean():.2%}, and above "
            f"{np.mean(far & (p >= PROBABLY)):.2%}"
        )
        if name == "all":
            known = (one for one in bins if one.count)
            lines += [
                f"  {one.confidence:.2f} said, {one.right:.2f} right, {one.count} frames" for one in known
            ]
    return lines


# Harder recordings: both right and wrong frames are needed

REDUCED = 0.3  # width of a small image over the recorded one's: eyes some 27 pixels apart
COVER_PX, COVER_FROM = (110, 90), 15
"""Height and width of what passes in front of the face, and the first frame with it."""
Hardening = Callable[[Sequence[ImageArray], int, np.random.Generator], ImageArray]


def _small(images: Sequence[ImageArray], index: int, rng: np.random.Generator) -> ImageArray:
    return _grey(cv2.resize(images[index], None, fx=REDUCED, fy=REDUCED, interpolation=cv2.INTER_AREA))


def _blurred(images: Sequence[ImageArray], index: int, rng: np.random.Generator) -> ImageArray:
    last = len(images) - 1
    near = [images[min(max(index + step, 0), last)].astype(np.float64) for step in (-1, 0, 1)]
    return _grey(np.mean(near, axis=0))


def _covered(images: Sequence[ImageArray], index: int, rng: np.random.Generator) -> ImageArray:
    """A blurred noise passes in front of the face three times, at three heights."""
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


KINDS: dict[str, Hardening] = {"small": _small, "blurred": _blurred, "covered": _covered, "dark": _dark}


def harden(recording: Path, output: Path, kind: str) -> None:
    """Write a recording (images of each camera, calibration.json, truth.csv) made harder."""
    calibration = json.loads((recording / CALIBRATION).read_text())
    for name, camera in calibration["cameras"].items():
        paths = sorted((recording / name).iterdir())
        images = [_grey(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)) for path in paths]
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


@click.group(help=__doc__)
def main() -> None:
    """Hold the commands."""


@main.command("hand")
@click.argument("results", nargs=-1, required=True)
def hand_command(results: tuple[str, ...]) -> None:
    """Fit to RESULTS of hands, each PERSON,RESULT.

    PERSON*,RESULT for a real recording, whose joints are marked by another convention, and
    NAME,RESULT,RIGHT,WRONG for a real one without truth: numbers of frames, such as 0-8-16.
    """
    told = (one.split(",") for one in results)
    frames = [hand_frames(person, Path(result), *judged) for person, result, *judged in told]
    print("\n".join(report(frames, HAND_REAL_SHARE, HAND_BOUNDS)))


@main.command("head")
@click.argument("results", nargs=-1, required=True)
def head_command(results: tuple[str, ...]) -> None:
    """Fit to RESULTS of heads, each PERSON,RESULT[,TRUTH].

    PERSON+ for a recording that is not hardened, PERSON~ for a real one with a reference.
    """
    told = (one.split(",") for one in results)
    frames = [head_frames(person, Path(result), *map(Path, truth)) for person, result, *truth in told]
    print("\n".join(report(frames, HEAD_REAL_SHARE, HEAD_BOUNDS)))


@main.command("harden")
@click.argument("recording", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("output", type=click.Path(path_type=Path))
@click.option("--kind", type=click.Choice(list(KINDS)), required=True)
def harden_command(recording: Path, output: Path, kind: str) -> None:
    """Make RECORDING harder: smaller, blurred (track every third frame, too), covered or dark."""
    harden(recording, output, kind)


if __name__ == "__main__":
    main()
