"""Pooling of results: metrics over the frames of several recordings, with equal weight for each frame.

Frame counts, shares, confidence metrics and the statistics of all metrics without parts are pooled
(``evaluation.measuring.catalogue.is_pooled``). Gates address them as ``pooled.NAME``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TypeAlias

from posetrack_cli.evaluation.measuring.catalogue import is_pooled, place_of
from posetrack_cli.evaluation.measuring.evaluate import coverage_metrics
from posetrack_cli.evaluation.measuring.evaluation import Collected, Count, Evaluation, Value
from posetrack_cli.evaluation.measuring.honesty import JudgedFrames, pooled_frames
from posetrack_cli.evaluation.measuring.measures import Measures
from posetrack_cli.evaluation.measuring.without_truth import HONESTY, honesty_metrics
from posetrack_cli.evaluation.reading.tracks import Coverage
from posetrack_cli.recording.base import RECORDING_KEY

POOLED = "pooled"
"""Name of a pool, and prefix of pooled metrics in gates."""
NO_FRAMES = "no result has a frame in common with its ground truth"


@dataclass(frozen=True, eq=False)
class Pool:
    """Pooled results with the same subject and track.

    Attributes:
        name: display name.
        subject: kind of subject.
        which: name of the track.
        results: names of the pooled results.
        coverage: sum of the frame counts.
        metrics: values by address, as in ``Evaluation``; only metrics that all members have.
        absent: reasons for missing values, by address.
        judged: judged frames of all members; None if a member has none.
        grouped: whether the pool is a group.
    """

    name: str
    subject: str
    which: str
    results: tuple[str, ...]
    coverage: Coverage
    metrics: Mapping[str, Value]
    absent: Mapping[str, str]
    judged: JudgedFrames | None
    grouped: bool = False

    @property
    def has_pooled_values(self) -> bool:
        """Whether the pool has values beyond those of a single result."""
        return len(self.results) > 1 and bool(self.metrics)


class PoolBuilder:
    """Accumulates the value distributions of a pool, one result at a time."""

    def __init__(self) -> None:
        self._collected: dict[str, Collected] = {}

    def add(self, evaluation: Evaluation) -> None:
        """Add the distributions of a result, which need not be kept afterwards."""
        for base, one in evaluation.distributions.items():
            self._collected.setdefault(base, Collected()).add(one)

    def statistics(self, results: int) -> dict[str, Value]:
        """Return the statistics of the metrics that all ``results`` results have."""
        return {
            base: of.total().statistics() for base, of in self._collected.items() if of.members == results
        }


PoolKey: TypeAlias = tuple[str, str] | str
"""Key of a pool: subject and track of ungrouped results, or the name of a group."""


def make_pools(
    evaluations: Sequence[Evaluation],
    groups: Mapping[str, Sequence[Evaluation]],
    builders: Mapping[PoolKey, PoolBuilder] | None = None,
) -> tuple[Pool, ...]:
    """Pool ungrouped results by subject and track, and the results of each group.

    Ungrouped results of the same recording are compared rather than pooled: their pool has no values, and
    states the reason.

    Args:
        evaluations: ungrouped results.
        groups: results by group; the members of a group have the same subject and track.
        builders: accumulated distributions of each pool; None takes them from the evaluations.
    """
    known = builders or {}
    kinds: dict[tuple[str, str], list[Evaluation]] = {}
    for one in evaluations:
        kinds.setdefault((one.subject, one.which), []).append(one)
    # Groups may contain the same recording twice, such as with several seeds: their pools always have values.
    alone = [pool(_name(of, kinds), of, _same_recording(of), known.get(kind)) for kind, of in kinds.items()]
    together = (pool(f"{POOLED} {name}", of, "", known.get(name)) for name, of in groups.items())
    return (*alone, *(replace(one, grouped=True) for one in together))


def _name(members: Sequence[Evaluation], kinds: Iterable[tuple[str, str]]) -> str:
    """Return the shortest unambiguous name of a pool."""
    first, kinds = members[0], list(kinds)
    subjects, tracks = ({kind[k] for kind in kinds} for k in (0, 1))
    more = [first.subject] * (len(subjects) > 1) + [first.which] * (len(tracks) > 1)
    return " ".join([POOLED, *more])


def _same_recording(members: Sequence[Evaluation]) -> str:
    """Return why these results must not be pooled: two are of the same recording. Empty otherwise."""
    first: dict[tuple[str, str], Evaluation] = {}
    for one in members:
        recording = one.run.get(RECORDING_KEY, "")
        other = first.setdefault((recording, one.label), one) if recording else one
        if other is not one:
            return (
                f"{other.name} and {one.name} are of the same recording, so the results are not pooled; "
                "use --group to pool by group"
            )
    return ""


def pool(
    name: str, members: Sequence[Evaluation], reason: str = "", builder: PoolBuilder | None = None
) -> Pool:
    """Pool results of one kind of subject.

    Metrics that a member lacks are not pooled. Confidence metrics are recomputed from all frames, so they can
    exist even if single results have no correct or no wrong frame.

    Args:
        name: name of the pool.
        members: at least one result.
        reason: reason not to pool the values; empty to pool them.
        builder: accumulated distributions; None takes them from the members.
    """
    if builder is None:
        builder = PoolBuilder()
        for one in members:
            builder.add(one)
    coverage = _added([one.coverage for one in members])
    judged = None if reason else _judged(members)
    measures = Measures(NO_FRAMES)
    if not reason:
        measures.metrics |= coverage_metrics(coverage) | _shares(members) | builder.statistics(len(members))
        if judged is not None:
            honesty_metrics(measures, judged)
    found = measures.metrics
    # A dict keeps the order of first occurrence, and sorted() is stable within a metric.
    every = dict.fromkeys((*_addresses(members), *found, *measures.absent))
    addresses = sorted(every, key=place_of)
    return Pool(
        name,
        members[0].subject,
        members[0].which,
        tuple(one.name for one in members),
        coverage,
        {base: found[base] for base in addresses if base in found},
        {
            base: reason or measures.absent.get(base) or _lacking(members, base)
            for base in addresses
            if base not in found
        },
        judged,
    )


def _added(coverages: Sequence[Coverage]) -> Coverage:
    """Add up frame counts; the sum has ground truth if all members have."""
    rows = [asdict(one) for one in coverages]
    added = {name: sum(row[name] for row in rows) for name in rows[0]}
    has = {
        "has_truth": all(one.has_truth for one in coverages),
        "has_identities": any(one.has_identities for one in coverages),
    }
    return Coverage(**{**added, **has})


def _judged(members: Sequence[Evaluation]) -> JudgedFrames | None:
    found = [one.judged for one in members if one.judged is not None]
    return pooled_frames(found) if len(found) == len(members) else None


def _shares(members: Sequence[Evaluation]) -> dict[str, Value]:
    """Return the pooled shares of the metrics that all members have counts of."""
    # Confidence metrics are not sums of shares; pool() recomputes them from all frames.
    first, *others = (one.counts for one in members)
    common = [base for base in first if base not in HONESTY and all(base in other for other in others)]
    return {base: _share([one.counts[base] for one in members]) for base in common}


def _share(counts: Sequence[Count]) -> float:
    return sum(one.true for one in counts) / sum(one.of for one in counts)


def _addresses(members: Sequence[Evaluation]) -> dict[str, None]:
    """Return the pooled addresses among those that a member has or lacks."""
    every = dict.fromkeys(base for one in members for base in (*one.metrics, *one.absent))
    return {base: None for base in every if is_pooled(base)}


def _lacking(members: Sequence[Evaluation], base: str) -> str:
    """Return the first member without a value, and its reason."""
    lacking = ((one.name, one.absent.get(base, "not measured")) for one in members if base not in one.metrics)
    name, reason = next(lacking, ("", NO_FRAMES))
    return f"{name}: {reason}" if name else reason
