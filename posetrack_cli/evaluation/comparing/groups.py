"""Groups of results, such as two trackers over the same recordings: paired recording by recording."""

from __future__ import annotations

import glob
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.comparing.comparison import UNCORRECTED, Comparison, Difference
from posetrack_cli.evaluation.comparing.paired import paired
from posetrack_cli.evaluation.evaluation import Evaluation, Statistics, statistics
from posetrack_cli.evaluation.figures import figure_of, studied_figures
from posetrack_cli.files import real_path
from posetrack_cli.recording.base import RECORDING_KEY

EXAMPLE = "such as rbpf='out/rbpf-*.mcap'"


RECORDINGS = "one recording"
Pair = tuple[Evaluation, Evaluation]


def expand_groups(texts: Iterable[str]) -> dict[str, tuple[Path, ...]]:
    """Return the files of each ``NAME=PATTERN``, sorted; a name may come more than once.

    Raises:
        UsageError: it is no such text, no file fits, or a file is in two groups.
    """
    groups: dict[str, tuple[Path, ...]] = {}
    for text in texts:
        name, pattern = _split(text)
        found = _matching(pattern)
        if not found:
            hint = f"files of a folder are {pattern.rstrip('/')}/*.mcap" if Path(pattern).is_dir() else ""
            raise UsageError(f"no file fits the pattern of group '{name}'", found=pattern, hint=hint)
        groups[name] = tuple(dict.fromkeys((*groups.get(name, ()), *found)))
    _check_disjoint(groups)
    return groups


def _split(text: str) -> tuple[str, str]:
    name, sign, pattern = (part.strip() for part in text.partition("="))
    if not (name and sign and pattern):
        raise UsageError(f"'{text}' is no group", expected="NAME=PATTERN", hint=EXAMPLE)
    return name, pattern


def _matching(pattern: str) -> Sequence[Path]:
    """Files that fit; a file whose very name has brackets is found by it."""
    if Path(pattern).is_file():
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
    """Which results of two groups belong together, and the names of those that do not."""

    pairs: tuple[Pair, ...]
    unpaired: tuple[str, ...]


def compare_groups(groups: Mapping[str, Sequence[Evaluation]]) -> Comparison:
    """Compare each group with the first: one figure of each result, paired by recording.

    Args:
        groups: at least two, by name, none of them empty.

    Raises:
        UsageError: the groups are of different subjects, or one has a recording twice with the same seed.
    """
    figures = _figures(groups)
    summaries = {name: _summary(members, figures) for name, members in groups.items()}
    (first, members), *others = groups.items()
    differences: list[Difference] = []
    notes: list[str] = []
    for second, rest in others:
        pairing = pair_by_recording(members, rest, names=(first, second))
        differences += _differences((first, second), pairing, figures)
        notes += _notes((first, second), pairing)
    return Comparison(RECORDINGS, tuple(differences), (*notes, UNCORRECTED), summaries)


def pair_by_recording(
    first: Sequence[Evaluation], second: Sequence[Evaluation], names: tuple[str, str] = ("first", "second")
) -> Pairing:
    """Pair the results of the same recording and seed; by recording alone where each group has one of it.

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
    """Results by recording, then seed; those whose run record names no recording are left out."""
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
                hint="give each its own group",
            )
        of_recording[seed] = one
    return found


def _figures(groups: Mapping[str, Sequence[Evaluation]]) -> tuple[str, ...]:
    """The figures of the subject that at least one result has."""
    members = [one for group in groups.values() for one in group]
    subjects = sorted({one.subject for one in members})
    if len(subjects) > 1:
        raise UsageError("groups of different subjects cannot be compared", found=" and ".join(subjects))
    figures = studied_figures(subjects[0])
    return tuple(f for f in figures if any(figure_of(one, f).value is not None for one in members))


def _summary(members: Sequence[Evaluation], figures: Iterable[str]) -> dict[str, Statistics]:
    found = {figure: [figure_of(one, figure).value for one in members] for figure in figures}
    return {figure: statistics([v for v in values if v is not None]) for figure, values in found.items()}


def _differences(names: tuple[str, str], pairing: Pairing, figures: Iterable[str]) -> Iterator[Difference]:
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
        yield f"{between}: no partner of the same recording and seed: {', '.join(pairing.unpaired)}"
    seeds = [(a.run.get("seed"), b.run.get("seed")) for a, b in pairing.pairs]
    if any(a != b for a, b in seeds):
        yield f"{between}: seeds differ, so pairs are of the same recording alone"
    recordings = len({a.run[RECORDING_KEY] for a, _ in pairing.pairs})
    if 0 < recordings < len(pairing.pairs):
        yield f"{between}: {len(pairing.pairs)} pairs are of {recordings} recordings: not all independent"
