"""Comparison of results and of groups of results, with confidence intervals and tests."""

from __future__ import annotations

import glob
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.measuring.catalogue import figure_of, place_of, studied_figures
from posetrack_cli.evaluation.measuring.evaluation import Evaluation, Statistics, statistics
from posetrack_cli.files import real_path
from posetrack_cli.recording.base import RECORDING_KEY

# Paired statistics. Errors of neighbouring frames are correlated, so blocks of one second serve as samples.


BLOCK_NS = 1_000_000_000
FEWEST_FOR_CORRELATION = 8


CONFIDENCE = 0.95
SIGNIFICANCE = 0.05
RESAMPLES = 9999
BATCH_VALUES = 1_000_000
"""Number of values that the bootstrap draws at a time; bounds its memory."""


@dataclass(frozen=True, eq=False)
class PairedBlocks:
    """Means of two series over one-second blocks of their common frames.

    Attributes:
        first, second: (B,) block means, in temporal order.
        frames: number of common frames with finite values in both series.
        left_out: number of frames of either series that are not among them.
    """

    first: FloatArray
    second: FloatArray
    frames: int
    left_out: int


def paired_blocks(
    first_ns: IntArray, first: FloatArray, second_ns: IntArray, second: FloatArray
) -> PairedBlocks:
    """Average two series of the same recording over one-second blocks of their common frames.

    Blocks start at the first common frame. All blocks have equal weight, including those with few frames.

    Args:
        first_ns, second_ns: (M1,), (M2,) stamps, strictly increasing.
        first, second: (M1,), (M2,) values; frames with a non-finite value are left out.
    """
    stamps, mine, theirs = np.intersect1d(first_ns, second_ns, assume_unique=True, return_indices=True)
    a, b = first[mine], second[theirs]
    usable = np.isfinite(a) & np.isfinite(b)
    stamps, a, b = stamps[usable], a[usable], b[usable]
    # Frames of one series only, plus common frames without a finite value (counted once).
    left_out = len(first_ns) + len(second_ns) - len(mine) - len(stamps)
    return PairedBlocks(block_means(stamps, a), block_means(stamps, b), len(stamps), left_out)


def block_means(stamp_ns: IntArray, values: FloatArray) -> FloatArray:
    """Return the mean of the values in each non-empty one-second block from the first stamp on.

    Args:
        stamp_ns: (M,) stamps, strictly increasing.
        values: (M,) values.
    """
    if not len(stamp_ns):
        return np.empty(0)
    _, block = np.unique((stamp_ns - stamp_ns[0]) // BLOCK_NS, return_inverse=True)
    means: FloatArray = np.bincount(block, values) / np.bincount(block)
    return means


def lag_one_correlation(differences: FloatArray) -> float:
    """Return the lag-1 autocorrelation of a series if it is significantly positive, else 0.

    r = sum_i (d_i - m) (d_{i+1} - m) / sum_i (d_i - m)^2. For independent values, |r| < 2 / sqrt(n) in 95 %
    of cases (Bartlett 1946). Smaller r, or r of fewer than eight values, is returned as 0.
    """
    centred = differences - differences.mean() if len(differences) else differences
    power = float(centred @ centred)
    if len(differences) < FEWEST_FOR_CORRELATION or power == 0:
        return 0.0
    r = float(centred[:-1] @ centred[1:]) / power
    return r if r > 2 / np.sqrt(len(differences)) else 0.0


@dataclass(frozen=True)
class Paired:
    """Comparison of two paired samples, second minus first.

    Attributes:
        count: number of pairs.
        mean_first, mean_second: means over the pairs; NaN without pairs.
        difference: mean of (second - first).
        low, high: 95 % bootstrap interval of the mean difference; NaN with fewer than two pairs.
        p_value: two-sided p-value of Wilcoxon's signed-rank test; 1 if no pair differs, NaN without pairs.
        note: limitation of the test; empty for none.
    """

    count: int
    mean_first: float
    mean_second: float
    difference: float
    low: float
    high: float
    p_value: float
    note: str = ""


def paired(first: ArrayLike, second: ArrayLike, rng_seed: int = 0) -> Paired:
    """Compare two paired samples, such as the errors of two trackers per recording.

    The test is Wilcoxon's signed-rank test (Wilcoxon 1945), two-sided, without pairs of equal values; exact
    for up to 50 pairs without ties, or up to 13 with ties, else by normal approximation. The interval is
    Efron's bias-corrected and accelerated (BCa) bootstrap interval (1987) of the mean difference. Both assume
    independent pairs; for frames of one recording, use ``paired_blocks`` first.

    Args:
        first, second: (n,) samples in the same unit.
        rng_seed: seed of the bootstrap.

    Raises:
        ValueError: the lengths differ, or a value is not finite.
    """
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 1:
        raise ValueError(f"paired samples of shapes {a.shape} and {b.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError("paired samples must be finite")
    if not len(a):
        nan = float("nan")
        return Paired(0, nan, nan, nan, nan, nan, nan, "no pairs")
    differences = b - a
    p_value, note = _signed_rank(differences)
    low, high = _interval(differences, rng_seed)
    means = (float(a.mean()), float(b.mean()), float(differences.mean()))
    return Paired(len(a), *means, low, high, p_value, note)


def _signed_rank(differences: FloatArray) -> tuple[float, str]:
    """Return the p-value, and a note if it cannot be significant."""
    from scipy.stats import wilcoxon

    different = differences[differences != 0]
    if not len(different):
        return 1.0, "no pair differs"
    smallest = 2.0 ** (1 - len(different))  # two of the 2^n equally likely sign patterns have equal signs
    pairs = "pair" if len(different) == 1 else "pairs"
    note = f"too few data: p >= {smallest:g} with {len(different)} differing {pairs}"
    return float(wilcoxon(different).pvalue), note if smallest > SIGNIFICANCE else ""


def _interval(differences: FloatArray, rng_seed: int) -> tuple[float, float]:
    from scipy.stats import bootstrap

    count = len(differences)
    if count < 2:
        return float("nan"), float("nan")
    if np.ptp(differences) == 0:  # BCa is undefined if all resamples are equal
        return float(differences[0]), float(differences[0])
    interval = bootstrap(
        (differences,),
        np.mean,
        n_resamples=RESAMPLES,
        batch=max(1, BATCH_VALUES // count),
        vectorized=True,
        confidence_level=CONFIDENCE,
        method="BCa",  # corrects bias and skewness, which errors with long tails have
        rng=np.random.default_rng(rng_seed),
    ).confidence_interval
    return float(interval.low), float(interval.high)


# Comparison of groups, such as two trackers over the same recordings, paired by recording


EXAMPLE = "e.g. rbpf='out/rbpf-*.mcap'"


RECORDINGS = "one recording"
Pair = tuple[Evaluation, Evaluation]


def expand_groups(texts: Iterable[str]) -> dict[str, tuple[Path, ...]]:
    """Return the sorted files of each ``NAME=PATTERN``; patterns with the same name are joined.

    Raises:
        UsageError: invalid syntax, a pattern without matches, or a file in two groups.
    """
    groups: dict[str, tuple[Path, ...]] = {}
    for text in texts:
        name, pattern = _split(text)
        found = _matching(pattern)
        if not found:
            hint = f"for a folder, use {pattern.rstrip('/')}/*.mcap" if Path(pattern).is_dir() else ""
            raise UsageError(f"no file matches the pattern of group '{name}'", found=pattern, hint=hint)
        groups[name] = tuple(dict.fromkeys((*groups.get(name, ()), *found)))
    _check_disjoint(groups)
    return groups


def _split(text: str) -> tuple[str, str]:
    name, sign, pattern = (part.strip() for part in text.partition("="))
    if not (name and sign and pattern):
        raise UsageError(f"invalid group '{text}'", expected="NAME=PATTERN", hint=EXAMPLE)
    return name, pattern


def _matching(pattern: str) -> Sequence[Path]:
    if Path(pattern).is_file():  # file names may contain brackets
        return [Path(pattern)]
    return [Path(name) for name in sorted(glob.glob(pattern, recursive=True)) if Path(name).is_file()]  # noqa: PTH207


def _check_disjoint(groups: dict[str, tuple[Path, ...]]) -> None:
    home: dict[Path, str] = {}
    for name, paths in groups.items():
        for path in paths:
            other = home.setdefault(real_path(path), name)
            if other != name:
                raise UsageError("file is in two groups", where=path, found=f"{other} and {name}")


@dataclass(frozen=True, eq=False)
class Pairing:
    """Pairs of results of two groups, and the names of unpaired results."""

    pairs: tuple[Pair, ...]
    unpaired: tuple[str, ...]


def compare_groups(groups: Mapping[str, Sequence[Evaluation]]) -> Comparison:
    """Compare each group with the first one by the values of their results, paired by recording.

    Args:
        groups: at least two non-empty groups, by name.

    Raises:
        UsageError: the groups have different subjects, or a group has two results of the same recording and
            seed.
    """
    figures = _figures(groups)
    summaries = {name: _summary(members, figures) for name, members in groups.items()}
    (first, members), *others = groups.items()
    differences: list[Difference] = []
    notes: list[str] = []
    for second, rest in others:
        pairing = pair_by_recording(members, rest, names=(first, second))
        differences += _group_differences((first, second), pairing, figures)
        notes += _notes((first, second), pairing)
    return Comparison(RECORDINGS, tuple(differences), (*notes, UNCORRECTED), summaries)


def pair_by_recording(
    first: Sequence[Evaluation], second: Sequence[Evaluation], names: tuple[str, str] = ("first", "second")
) -> Pairing:
    """Pair results of the same recording and seed, or only recording if both groups have one result of it.

    Raises:
        UsageError: a group has two results of the same recording and seed.
    """
    mine, theirs = (_by_recording(of, name) for of, name in zip((first, second), names, strict=True))
    pairs: list[Pair] = []
    for recording in mine:
        a, b = mine[recording], theirs.get(recording, {})
        if len(a) == len(b) == 1:
            pairs += zip(a.values(), b.values(), strict=True)
        else:
            pairs += [(a[seed], b[seed]) for seed in a if seed in b]
    paired_already = {id(one) for pair in pairs for one in pair}
    unpaired = (one.name for one in (*first, *second) if id(one) not in paired_already)
    return Pairing(tuple(pairs), tuple(unpaired))


def _by_recording(members: Iterable[Evaluation], group: str) -> dict[str, dict[str, Evaluation]]:
    """Return results by recording and seed, without those whose run record has no recording."""
    found: dict[str, dict[str, Evaluation]] = {}
    for one in members:
        recording, seed = one.run.get(RECORDING_KEY, ""), one.run.get("seed", "")
        if not recording:
            continue
        of_recording = found.setdefault(recording, {})
        if seed in of_recording:
            both = f"{of_recording[seed].name} and {one.name}"
            raise UsageError(
                f"group '{group}' has two results of the same recording and seed",
                found=both,
                hint="put them into different groups",
            )
        of_recording[seed] = one
    return found


def _figures(groups: Mapping[str, Sequence[Evaluation]]) -> tuple[str, ...]:
    """Return the addresses of the subject that at least one result has a value for."""
    members = [one for group in groups.values() for one in group]
    subjects = sorted({one.subject for one in members})
    if len(subjects) > 1:
        raise UsageError("groups of different subjects cannot be compared", found=" and ".join(subjects))
    figures = studied_figures(subjects[0])
    return tuple(f for f in figures if any(figure_of(one, f).value is not None for one in members))


def _summary(members: Sequence[Evaluation], figures: Iterable[str]) -> dict[str, Statistics]:
    found = {figure: [figure_of(one, figure).value for one in members] for figure in figures}
    return {figure: statistics([v for v in values if v is not None]) for figure, values in found.items()}


def _group_differences(
    names: tuple[str, str], pairing: Pairing, figures: Iterable[str]
) -> Iterator[Difference]:
    for figure in figures:
        values = [(figure_of(a, figure), figure_of(b, figure)) for a, b in pairing.pairs]
        whole = [(a.value, b.value) for a, b in values if a.value is not None and b.value is not None]
        result = paired([a for a, _ in whole], [b for _, b in whole])
        notes = [result.note, *_left_out(pairing.pairs, figure)]
        yield Difference(figure, *names, result, "; ".join(filter(None, notes)))


def _left_out(pairs: Iterable[Pair], figure: str) -> Iterator[str]:
    for one in (one for pair in pairs for one in pair):
        reason = figure_of(one, figure).reason
        if reason:
            yield f"without {one.name} ({reason})"


def _notes(names: tuple[str, str], pairing: Pairing) -> Iterator[str]:
    between = f"{names[1]} - {names[0]}"
    if pairing.unpaired:
        yield f"{between}: unpaired (no result of the same recording and seed): {', '.join(pairing.unpaired)}"
    seeds = [(a.run.get("seed"), b.run.get("seed")) for a, b in pairing.pairs]
    if any(a != b for a, b in seeds):
        yield f"{between}: seeds differ, so results are paired by recording only"
    recordings = len({a.run[RECORDING_KEY] for a, _ in pairing.pairs})
    if 0 < recordings < len(pairing.pairs):
        yield f"{between}: {len(pairing.pairs)} pairs of {recordings} recordings are not all independent"


# Comparison of results of the same recording, paired by one-second blocks


SECONDS = "one second of a recording"
UNCORRECTED = "p-values are not corrected for multiple comparisons"


@dataclass(frozen=True)
class Difference:
    """Difference of a metric between two results or groups.

    Attributes:
        figure: address, such as ``joint_error_mm`` or ``joint_error_mm.mean``.
        first, second: names; the difference is second minus first.
        paired: means, difference, interval and test.
        note: limitation of the comparison; empty for none.
    """

    figure: str
    first: str
    second: str
    paired: Paired
    note: str


@dataclass(frozen=True)
class Comparison:
    """Paired differences between results or groups.

    Attributes:
        unit: unit of the pairs: one second of a recording, or one recording.
        differences: differences, ordered by pair of names, then by metric.
        notes: remarks on all differences.
        groups: statistics over the results of each group, by group and address; empty without groups.
    """

    unit: str
    differences: tuple[Difference, ...]
    notes: tuple[str, ...]
    groups: Mapping[str, Mapping[str, Statistics]] = field(default_factory=dict)


def compare(evaluations: Sequence[Evaluation]) -> Comparison | None:
    """Compare each result with the first one of the same recording, by all common per-frame series.

    The samples are blocks of one second (``paired_blocks``).

    Returns:
        None if no two results are of the same recording.
    """
    by_recording: dict[tuple[str, str], list[Evaluation]] = {}
    for one in evaluations:
        by_recording.setdefault((one.run.get(RECORDING_KEY, ""), one.label), []).append(one)
    alone = [key for key, of in by_recording.items() if len(of) < 2 or not key[0]]
    differences = [
        difference
        for recording, (first, *others) in by_recording.items()
        if recording not in alone
        for second in others
        for difference in _differences(first, second)
    ]
    if not differences:
        return None
    names = ", ".join(one.name for recording in alone for one in by_recording[recording])
    notes = [f"no other result of the same recording: {names}"] if names else []
    return Comparison(SECONDS, tuple(differences), (*notes, UNCORRECTED))


def _differences(first: Evaluation, second: Evaluation) -> Iterator[Difference]:
    """Yield the differences of all common series, in catalogue order."""
    common = [name for name in first.series if name in second.series]
    for figure in sorted(common, key=place_of):
        yield _difference(figure, first, second)


def _difference(figure: str, first: Evaluation, second: Evaluation) -> Difference:
    blocks = paired_blocks(
        first.series_stamp_ns, first.series[figure], second.series_stamp_ns, second.series[figure]
    )
    result = paired(blocks.first, blocks.second)
    notes = [result.note]
    if blocks.left_out:
        notes.append(f"{blocks.left_out} frames without a value in both are left out")
    correlation = lag_one_correlation(blocks.second - blocks.first)
    if correlation:
        notes.append(f"consecutive seconds are correlated (r = {correlation:.2f}), so p is too small")
    return Difference(figure, first.name, second.name, result, "; ".join(filter(None, notes)))
