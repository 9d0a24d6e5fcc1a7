"""What the points in a file are of: their names, and how many another program counts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field


def _unchanged(name: str) -> str:
    return name


@dataclass(frozen=True)
class PointKind:
    """A subject's points.

    Attributes:
        subject: such as ``hand``.
        names: ours, in our order; a set has so many points.
        counted: by how many points a program gives, which of ours each of them is; those that are none of
            ours are not listed.
        several: fields of JSON frames that list several subjects.
        plain: makes of a lower-case name of another program's ours, where it is one.
        flat: fields of OpenPose's people with x, y, score of each point, and the side that each is of.
        parts: points of COCO's 133 of a whole body, and the side that each part is of.
        ends: what the first and the last point are, for errors.
        command: whose help says more.
    """

    subject: str
    names: tuple[str, ...]
    counted: Mapping[int, Mapping[int, int]]
    several: tuple[str, ...]
    command: str
    plain: Callable[[str], str] = field(default=_unchanged)
    flat: Mapping[str, str] = field(default_factory=dict)
    parts: Mapping[str, slice] = field(default_factory=dict)
    ends: tuple[str, str] = ("", "")

    @property
    def size(self) -> int:
        """How many points a set has."""
        return len(self.names)

    @property
    def most(self) -> int:
        """How many points a program gives at most."""
        return max(self.counted)

    @property
    def counts(self) -> str:
        """How many points a program may give, for people: ``21``, or ``10, 68 or 478``."""
        *others, last = (str(count) for count in sorted(self.counted))
        return f"{', '.join(others)} or {last}" if others else last

    @property
    def expected(self) -> str:
        """What JSON is to hold, for errors."""
        points = f"{self.counts} of [x, y], [x, y, z] or {{x, y, z}}"
        return f"a list of frames, each with landmarks: {points}"

    @property
    def range(self) -> str:
        """The numbers of our own points, for errors."""
        first, last = (f" ({end})" if end else "" for end in self.ends)
        return f"0{first} to {self.size - 1}{last}"

    def number(self, name: str) -> int | None:
        """Return the number of a point by ours or another program's name of it; None for any other."""
        plain = self.plain(name.strip().lower().replace("-", "_").replace(" ", "_"))
        return self.names.index(plain) if plain in self.names else None

    def places(self, points: int) -> Mapping[int, int] | None:
        """Return which of ours each of so many points is; None if no program gives so many."""
        return self.counted.get(points)


def same_order(count: int) -> Mapping[int, int]:
    """Return the places of points that are ours, in our order."""
    return {k: k for k in range(count)}


def by_index(indices: Sequence[int]) -> Mapping[int, int]:
    """Return the places of points of which these, in our order, are ours."""
    return {index: place for place, index in enumerate(indices)}
