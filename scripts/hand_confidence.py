"""What the confidence of hands is made from: results with their truth, and the regression's weights.

A result's ``sign_...`` numbers are what its confidence was made from. ``scripts/hand-confidence`` reads some,
tells the weights of ``hand.confidence`` that fit them best, and what these are worth on people that they were
not fitted to: each person, in all recordings, is left out in turn. Recordings made by a program and real ones
count alike, however many there are of either: rendered hands alone make one doubt real ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.honesty import calibration_error, reliability, roc_area
from posetrack_cli.evaluation.metrics.measures import rows_of
from posetrack_cli.evaluation.subjects.hand import FAR_MM
from posetrack_cli.hand.confidence import RIGHT_MM, SIGN_NAMES
from posetrack_cli.results import load_arrays, read_result
from posetrack_cli.tracking.confidence import PROBABLY, Regression
from reproduction.regression import AGAINST, FOR, left_out, regression_of
from reproduction.strangers.measuring import frames_of

OFFSETS = "*"
MEANINGS = (AGAINST, AGAINST, AGAINST, FOR, AGAINST)
"""What signs can mean: costs, innovation and alternatives against, contrast for a frame."""


@dataclass(frozen=True, eq=False)
class Frames:
    """The frames of a result in which a hand was followed, whether it says so or not.

    Attributes:
        person: who it is of.
        signs: (M, S).
        right: (M,) whether the joints are.
        far: (M,) whether they are more than 40 mm off.
        stated: (M,) the result's own confidence.
        is_real: whether a sensor recorded it.
    """

    person: str
    signs: FloatArray
    right: BoolArray
    far: BoolArray
    stated: FloatArray
    is_real: bool = False


def read_frames(person: str, result: Path, *, without_offsets: bool) -> Frames:
    """Read a result that carries its truth, with or without a constant offset per bone in its errors."""
    options = EvalOptions(joint_offsets="bone") if without_offsets else EvalOptions()
    found = evaluate(result, options)
    frames = frames_of(found)
    if frames is None or found.pairs is None or found.track.confidence is None:
        raise click.ClickException(
            f"{result}: no truth with a wrist, expected: a recording's that carries it"
        )
    signs, error = read_signs(result)[found.pairs.estimate], frames.error
    seen = np.isfinite(signs).all(axis=1)
    stated = rows_of(found.track.confidence, found.pairs.estimate)
    right, far = error[seen] < RIGHT_MM, error[seen] > FAR_MM
    return Frames(person, signs[seen], right, far, stated[seen], is_real=without_offsets)


def read_signs(result: Path) -> FloatArray:
    """Return the signs (M, S) of all frames of a result; NaN where it has none."""
    numbers = read_result(result).numbers()
    return np.stack([np.asarray(numbers[name]) for name in SIGN_NAMES], axis=1)


def read_judged(person: str, result: Path, right: Sequence[int], wrong: Sequence[int]) -> Frames:
    """Read frames of a real recording without a truth that somebody has looked at, and found right or wrong.

    What is wrong to the eye need not be far off, and counts as not.
    """
    chosen = np.array([*right, *wrong], dtype=np.int64)
    stated = np.asarray(load_arrays(result)["confidence"])[chosen]
    is_right = np.arange(len(chosen)) < len(right)
    far = np.zeros(len(chosen), dtype=bool)
    return Frames(person, read_signs(result)[chosen], is_right, far, stated, is_real=True)


def fitted(frames: Sequence[Frames]) -> Regression:
    """Return the regression of most likelihood: recordings of a kind count alike, and both kinds."""
    return regression_of(frames, [1.0] * len(frames), 1.0, MEANINGS)


def report(frames: Sequence[Frames]) -> list[str]:
    """Return the weights in words, and what they are worth on people they were not fitted to."""
    probabilities, final = left_out(frames, fitted), fitted(frames)
    lines = [f"bias {final.bias:.2f}, weights {', '.join(f'{w:.2f}' for w in final.weights)}"]
    for name in ("all", *sorted({one.person for one in frames})):
        chosen = [k for k, one in enumerate(frames) if name in ("all", one.person)]
        p = np.concatenate([probabilities[k] for k in chosen])
        right, far, stated = (
            np.concatenate([getattr(frames[k], field) for k in chosen])
            for field in ("right", "far", "stated")
        )
        bins = reliability(p, right)
        lines.append(
            f"{name}: {len(p)} frames, {right.mean():.1%} right; ROC area {roc_area(p, right):.3f} (as stated"
            f" {roc_area(stated, right):.3f}); calibration error {calibration_error(bins):.3f}; below"
            f" {PROBABLY:g} {np.mean(p < PROBABLY):.1%}; far {far.mean():.2%}, and above"
            f" {np.mean(far & (p >= PROBABLY)):.2%} (as stated {np.mean(far & (stated >= PROBABLY)):.2%})"
        )
        if name == "all":
            told = (
                f"  {b.confidence:.2f} said, {b.right:.2f} right, {b.count} frames" for b in bins if b.count
            )
            lines.extend(told)
    return lines


@click.command(help=__doc__)
@click.argument("results", nargs=-1, required=True)
def main(results: tuple[str, ...]) -> None:
    """Fit to RESULTS, each PERSON,RESULT.

    PERSON*,RESULT for a real recording, whose joints are marked by another convention, and
    NAME,RESULT,RIGHT,WRONG for a real one without truth: numbers of frames that were looked at, such as
    0-8-16.
    """
    print("\n".join(report([_read(*one.split(",")) for one in results])))


def _read(person: str, result: str, *judged: str) -> Frames:
    if judged:
        right, wrong = ([int(k) for k in some.split("-") if k] for some in judged)
        return read_judged(person, Path(result), right, wrong)
    name = person.removesuffix(OFFSETS)
    return read_frames(name, Path(result), without_offsets=person.endswith(OFFSETS))


if __name__ == "__main__":
    main()
