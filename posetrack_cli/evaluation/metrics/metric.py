"""What a metric is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

Better: TypeAlias = Literal["lower", "higher", "neither"]
PartKind: TypeAlias = Literal["joint", "finger", "angle", "point", "state"]
Group: TypeAlias = Literal["coverage", "accuracy", "velocity", "covariance", "honesty", "consistency", "run"]

GROUP_TITLES: dict[Group, str] = {
    "coverage": "Coverage",
    "accuracy": "Error against truth",
    "velocity": "Velocity error against truth",
    "covariance": "Stated covariance against truth",
    "honesty": "Honesty against truth",
    "consistency": "Self-consistency, without truth",
    "run": "Run",
}
"""The groups in the order of every table."""

_UNIT_ENDINGS = ("_deg_s", "_mm_s", "_mm", "_deg", "_px", "_s")


@dataclass(frozen=True)
class Metric:
    """What a figure means.

    Attributes:
        name: first word of its address; ends in its unit where it has one.
        unit: mm, deg, s, ...; empty for counts and shares.
        meaning: one sentence.
        part: kind of the parts that it is told for besides the whole; None for none.
        group: where tables show it.
        better: which way an improvement goes; ``neither`` where the figure has a target or none at all.
        scalar: one number; otherwise ``Statistics``.
        spoken: what a page calls it; by default the name without its unit.
        needs_depth: whether it is measured against depth images.
        pooled: of one number, whether it is told of several results together, too; ``Statistics`` always are.
    """

    name: str
    unit: str
    meaning: str
    part: PartKind | None = None
    group: Group = "accuracy"
    better: Better = "lower"
    scalar: bool = False
    spoken: str = ""
    needs_depth: bool = False
    pooled: bool = False

    @property
    def label(self) -> str:
        """What a page calls it."""
        endings = (self.name.removesuffix(end) for end in _UNIT_ENDINGS if self.name.endswith(end))
        return self.spoken or next(endings, self.name).replace("_", " ")
