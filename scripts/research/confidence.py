"""Fit the confidence of hands and heads to results with ground truth; make harder head recordings for it.

Confidence is a regression on a result's ``sign_...`` numbers. The commands print the best weights for
``hand.confidence`` or ``head.tracker.frame_tracker``, and their quality in leave-one-person-out
cross-validation.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
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
from posetrack_cli.geometry.rotations import (
    angle_between,
    conjugate,
    head_quaternion_from_roll_pitch_yaw,
    multiply,
)
from posetrack_cli.hand import confidence as of_hands
from posetrack_cli.head import subject as of_heads
from posetrack_cli.results import load_arrays, read_result
from posetrack_cli.tracking.confidence import PROBABLY, Regression
from research import hands
from research.heads import CALIBRATION, TRUTH, Compared, compare

Bounds = tuple[float | None, float | None]
PENALTY = 1e-3  # on squared weights, for standardised signs
AGAINST: Bounds = (None, 0.0)
FOR: Bounds = (0.0, None)  # bounds of weights of signs that can only lower, or raise, the confidence
# Costs, innovation and alternatives lower the confidence, contrast raises it
HAND_BOUNDS = (AGAINST, AGAINST, AGAINST, FOR, AGAINST)
# All signs lower the confidence of a head; a positive weight would overfit these people
HEAD_BOUNDS = [AGAINST] * len(of_heads.SIGN_NAMES)
# Total weight of real against rendered recordings; the references of real heads are inaccurate
HAND_REAL_SHARE, HEAD_REAL_SHARE = 1.0, 0.25
USUAL_WEIGHT = 4.0  # weight of an unmodified head recording against a hardened one
# Error of the reference of a real head. Frames whose error exceeds the limit for right ones by one to two
# times this are ambiguous and left out.
UNSURE_DEG, UNSURE_MM = 3.0, 1.0
OFFSETS, USUAL, REAL = "*", "+", "~"


class Frames(NamedTuple):
    """The M frames of a result that have signs, whatever their status."""

    person: str
    signs: FloatArray  # (M, S)
    right: BoolArray  # (M,) whether the estimate is right
    far: BoolArray  # (M,) whether the estimate is far off
    is_real: bool = False  # whether it was recorded by a sensor
    weight: float = 1.0  # of the recording among real or rendered ones


def signs_of(result: Path, names: Sequence[str]) -> FloatArray:
    """Return the signs (M, S) of all frames of a result; NaN if missing."""
    numbers = read_result(result).numbers()
    return np.stack([np.asarray(numbers[name]) for name in names], axis=1)


def hand_frames(person: str, result: Path, *judged: str) -> Frames:
    """Read the result of a hand.

    Args:
        person: name; the suffix ``OFFSETS`` marks ground truth with other joint definitions.
        result: result with ground truth.
        judged: instead of ground truth, frame numbers judged right and wrong, such as ``0-8-16``.
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
        raise click.ClickException(f"{result}: no ground truth with a wrist")
    signs = signs[found.pairs.estimate]
    seen = np.isfinite(signs).all(axis=1)
    error = frames.error[seen]
    return Frames(name, signs[seen], error < of_hands.RIGHT_MM, error > FAR_MM, is_real)


def head_frames(person: str, result: Path, truth: Path | None = None) -> Frames:
    """Read the result of a head and compare it with ground truth.

    Constant offsets of the head's frame, and of each point in it, are removed from the errors.

    Args:
        person: name; the suffix ``USUAL`` marks a recording that is not hardened, ``REAL`` a real one, whose
            reference is inaccurate.
        result: result of ``posetrack head``.
        truth: ground truth file; None for the ground truth in the result.
    """
    one, is_real = compare(result, truth), person.endswith(REAL)
    rotation_deg = typical_rotation_deg(one)
    usual = one.followed & (rotation_deg <= of_heads.RIGHT_DEG)
    shapes = replace(one, followed=usual).points_mm()[1].mean(axis=1)

    def within(unsure: float) -> BoolArray:
        """Return (M,) whether rotations and points are right, within ``unsure`` reference errors."""
        turned = rotation_deg <= of_heads.RIGHT_DEG + unsure * UNSURE_DEG
        found: BoolArray = turned & (shapes <= of_heads.RIGHT_MM + unsure * UNSURE_MM)
        return found

    signs = signs_of(result, of_heads.SIGN_NAMES)
    stamps = np.asarray(load_arrays(result)["stamp_ns"])
    signs = signs[np.searchsorted(stamps, one.stamp_ns)]
    right, nearly = (within(factor * is_real) for factor in (1.0, 2.0))
    chosen = np.isfinite(signs).all(axis=1) & (right | ~nearly)
    far, weight = rotation_deg > FAR_DEG, USUAL_WEIGHT if person.endswith(USUAL) else 1.0
    return Frames(person.rstrip(USUAL + REAL), signs[chosen], right[chosen], far[chosen], is_real, weight)


def typical_rotation_deg(one: Compared) -> FloatArray:
    """Return rotation errors (M,) after removal of the offset of the most typical frame.

    The mean offset of a hard recording is that of its wrong frames: it would make the right ones wrong.
    """
    mine, theirs = (
        head_quaternion_from_roll_pitch_yaw(np.radians(columns[:, 3:]))
        for columns in (one.columns, one.true_columns)
    )
    offsets = multiply(conjugate(theirs), mine)
    apart = np.degrees(angle_between(offsets[:, None], offsets[None]))
    followed = np.flatnonzero(one.followed) if one.followed.any() else np.arange(len(apart))
    chosen: FloatArray = apart[followed[np.argmin(apart[np.ix_(followed, followed)].sum(axis=1))]]
    return chosen


def fitted(frames: Sequence[Frames], real_share: float, bounds: Sequence[Bounds]) -> Regression:
    """Fit the maximum-likelihood regression with bounds on the weights of signs.

    Recordings count by their weight, regardless of their number of frames; real ones together count
    ``real_share`` against all others.
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
    """Return weights and cross-validation figures as lines of text."""
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


# Hardened recordings: the fit needs wrong frames as well

REDUCED = 0.3  # scale of small images: about 27 pixels between the eyes
# Height and width of the occluder, px, and its first frame
COVER_PX, COVER_FROM = (110, 90), 15
Hardening = Callable[[Sequence[ImageArray], int, np.random.Generator], ImageArray]


def _small(images: Sequence[ImageArray], index: int, rng: np.random.Generator) -> ImageArray:
    return _grey(cv2.resize(images[index], None, fx=REDUCED, fy=REDUCED, interpolation=cv2.INTER_AREA))


def _blurred(images: Sequence[ImageArray], index: int, rng: np.random.Generator) -> ImageArray:
    last = len(images) - 1
    near = [images[min(max(index + step, 0), last)].astype(np.float64) for step in (-1, 0, 1)]
    return _grey(np.mean(near, axis=0))


def _covered(images: Sequence[ImageArray], index: int, rng: np.random.Generator) -> ImageArray:
    """Move a patch of blurred noise across the face three times, at three heights."""
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
    """Write a hardened copy of a recording (images of each camera, calibration.json, truth.csv)."""
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
    """Command group."""


@main.command("hand")
@click.argument("results", nargs=-1, required=True)
def hand_command(results: tuple[str, ...]) -> None:
    """Fit the confidence to RESULTS of hands, each given as PERSON,RESULT.

    PERSON*,RESULT is a real recording whose joints are defined differently; NAME,RESULT,RIGHT,WRONG is a
    real one without ground truth, with the numbers of right and wrong frames, such as 0-8-16.
    """
    given = (one.split(",") for one in results)
    frames = [hand_frames(person, Path(result), *judged) for person, result, *judged in given]
    print("\n".join(report(frames, HAND_REAL_SHARE, HAND_BOUNDS)))


@main.command("head")
@click.argument("results", nargs=-1, required=True)
def head_command(results: tuple[str, ...]) -> None:
    """Fit the confidence to RESULTS of heads, each given as PERSON,RESULT[,TRUTH].

    PERSON+ is a recording that is not hardened, PERSON~ a real one with a reference.
    """
    given = (one.split(",") for one in results)
    frames = [head_frames(person, Path(result), *map(Path, truth)) for person, result, *truth in given]
    print("\n".join(report(frames, HEAD_REAL_SHARE, HEAD_BOUNDS)))


@main.command("harden")
@click.argument("recording", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("output", type=click.Path(path_type=Path))
@click.option("--kind", type=click.Choice(list(KINDS)), required=True)
def harden_command(recording: Path, output: Path, kind: str) -> None:
    """Write a harder copy of RECORDING: small, blurred (track every third frame), covered or dark."""
    harden(recording, output, kind)


if __name__ == "__main__":
    main()
