"""Several results as one: each frame counts alike, whichever recording it is of.

What is pooled are counts of frames, shares, what a track says of itself, and the statistics of every metric
as a whole (``evaluation.measuring.catalogue.is_pooled``). A gate addresses them by ``pooled.NAME``.
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
"""What results together are called."""
NO_FRAMES = "the results have no frame in common with their truth"


@dataclass(frozen=True, eq=False)
class Pool:
    """Results of one kind of subject and track, together.

    Attributes:
        name: what tables call it.
        subject: of all of them.
        which: of their tracks.
        results: their names.
        coverage: their counts of frames, added up.
        metrics: values by address, as of an ``Evaluation``; only what every member has.
        absent: the addresses that are pooled and have no value, and why.
        judged: all their frames with a truth; None where a member has none.
        grouped: whether they are a group.
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
    def says_more(self) -> bool:
        """Whether it has figures that no single result has."""
        return len(self.results) > 1 and bool(self.metrics)


class Gathered:
    """The values of results that are pooled, as they are measured one after the other."""

    def __init__(self) -> None:
        self._collected: dict[str, Collected] = {}

    def add(self, evaluation: Evaluation) -> None:
        """Take the distributions of a result, which it then need not keep."""
        for base, one in evaluation.distributions.items():
            self._collected.setdefault(base, Collected()).add(one)

    def statistics(self, results: int) -> dict[str, Value]:
        """Return the figures that each of so many results had."""
        return {
            base: of.total().statistics() for base, of in self._collected.items() if of.members == results
        }


PoolKey: TypeAlias = tuple[str, str] | str
"""What is pooled: a subject and a track of the results that are in no group, or a group's name."""


def make_pools(
    evaluations: Sequence[Evaluation],
    groups: Mapping[str, Sequence[Evaluation]],
    gathered: Mapping[PoolKey, Gathered] | None = None,
) -> tuple[Pool, ...]:
    """Pool results that stand for themselves, by subject and track, and those of each group.

    Results of one recording that are in no group are there to be compared, not to be counted twice: such
    pools have no figures, and say why.

    Args:
        evaluations: that are in no group.
        groups: by name; the members of one are of the same subject and track.
        gathered: the values of each pool; by default the evaluations have them still.
    """
    known = gathered or {}
    kinds: dict[tuple[str, str], list[Evaluation]] = {}
    for one in evaluations:
        kinds.setdefault((one.subject, one.which), []).append(one)
    alone = [pool(_name(of, kinds), of, _same_recording(of), known.get(kind)) for kind, of in kinds.items()]
    together = (pool(f"{POOLED} {name}", of, "", known.get(name)) for name, of in groups.items())
    return (*alone, *(replace(one, grouped=True) for one in together))


def _name(members: Sequence[Evaluation], kinds: Iterable[tuple[str, str]]) -> str:
    """As short as tells the pools apart."""
    first, kinds = members[0], list(kinds)
    subjects, tracks = ({kind[k] for kind in kinds} for k in (0, 1))
    more = [first.subject] * (len(subjects) > 1) + [first.which] * (len(tracks) > 1)
    return " ".join([POOLED, *more])


def _same_recording(members: Sequence[Evaluation]) -> str:
    """Why these results are not one sample, or nothing."""
    first: dict[str, Evaluation] = {}
    for one in members:
        recording = one.run.get(RECORDING_KEY, "")
        other = first.setdefault(recording, one) if recording else one
        if other is not one:
            return (
                f"{other.name} and {one.name} are of one recording, so results are compared, not pooled; "
                "--group pools each group"
            )
    return ""


def pool(
    name: str, members: Sequence[Evaluation], reason: str = "", gathered: Gathered | None = None
) -> Pool:
    """Pool results of one kind of subject.

    A figure that one of them lacks is not made of the others alone. What confidence says is made anew from
    all frames, also where single results have no wrong frame or no right one.

    Args:
        name: what the pool is called.
        members: at least one.
        reason: why they have no figures together; by default they do.
        gathered: their values; by default they have them still.
    """
    if gathered is None:
        gathered = Gathered()
        for one in members:
            gathered.add(one)
    coverage = _added([one.coverage for one in members])
    judged = None if reason else _judged(members)
    measures = Measures(NO_FRAMES)
    if not reason:
        measures.metrics |= coverage_metrics(coverage) | _shares(members) | gathered.statistics(len(members))
        if judged is not None:
            honesty_metrics(measures, judged)
    found = measures.metrics
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
    """Counts added up; there is a truth where all have one."""
    rows = [asdict(one) for one in coverages]
    added = {name: sum(row[name] for row in rows) for name in rows[0]}
    return Coverage(**{**added, "has_truth": all(one.has_truth for one in coverages)})


def _judged(members: Sequence[Evaluation]) -> JudgedFrames | None:
    found = [one.judged for one in members if one.judged is not None]
    return pooled_frames(found) if len(found) == len(members) else None


def _shares(members: Sequence[Evaluation]) -> dict[str, Value]:
    """The shares that all have counts of, each entry counting alike."""
    first, *others = (one.counts for one in members)
    common = [base for base in first if base not in HONESTY and all(base in other for other in others)]
    return {base: _share([one.counts[base] for one in members]) for base in common}


def _share(counts: Sequence[Count]) -> float:
    return sum(one.true for one in counts) / sum(one.of for one in counts)


def _addresses(members: Sequence[Evaluation]) -> dict[str, None]:
    """What is pooled of everything that a member has or lacks."""
    every = dict.fromkeys(base for one in members for base in (*one.metrics, *one.absent))
    return {base: None for base in every if is_pooled(base)}


def _lacking(members: Sequence[Evaluation], base: str) -> str:
    """Why a figure of all is missing: the first that has none, and its reason."""
    lacking = ((one.name, one.absent.get(base, "not measured")) for one in members if base not in one.metrics)
    name, reason = next(lacking, ("", NO_FRAMES))
    return f"{name}: {reason}" if name else reason
