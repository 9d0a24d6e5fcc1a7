"""Who is recorded: strangers by their numbers, and what is drawn of each of them."""

from __future__ import annotations

import re
from dataclasses import dataclass

from posetrack_cli.errors import UsageError

FINAL = 900
"""Persons and motions from here on are for final measurements only."""
MOST_PEOPLE = 1000
"""More in one study is a slip of the pen."""
_RANGE = re.compile(r"(\d{1,6})(?:-(\d{1,6}))?")


@dataclass(frozen=True)
class Person:
    """A stranger, who moves as the motion of the same number says.

    Attributes:
        number: of person and motion.
    """

    number: int

    @property
    def side(self) -> str:
        """Which hand is shown: the left one of every second person."""
        return "left" if self.number % 2 else "right"

    @property
    def shows_back(self) -> bool:
        """Whether the back of the hand faces the camera: of every third person."""
        return self.number % 3 == 0

    @property
    def title(self) -> str:
        """What tables call the person."""
        return f"{self.number} {self.side}{', back' if self.shows_back else ''}"

    def recording(self, frames: int, *more: str) -> tuple[str, ...]:
        """Arguments of the tool that make a recording of so many frames; the folder goes before them."""
        seeds = ("--person", str(self.number), "--motion", str(self.number), "--frames", str(frames))
        left = ("--left",) if self.side == "left" else ()
        return (*seeds, *left, *(("--back",) if self.shows_back else ()), *more)


def people_of(text: str, *, final: bool) -> tuple[Person, ...]:
    """Return the people that a text such as ``800-819`` or ``800,803-805`` names, each once, in order.

    Args:
        text: numbers and ranges, both ends included, with commas between them.
        final: whether people that are kept for final measurements may be among them.

    Raises:
        UsageError: it names nobody, or somebody who is kept for final measurements.
    """
    people = sorted({number for part in text.split(",") for number in _numbers(part.strip(), text)})
    if people[-1] >= FINAL and not final:
        raise UsageError(
            "this person is for final measurements only",
            found=people[-1],
            expected=f"less than {FINAL}",
            hint="--final measures such people",
        )
    return tuple(map(Person, people))


def _numbers(part: str, text: str) -> range:
    """The numbers of one of the parts between commas."""
    found = _RANGE.fullmatch(part)
    numbers = range(int(found[1]), int(found[2] or found[1]) + 1) if found else range(0)
    if not 0 < len(numbers) <= MOST_PEOPLE:
        expected = f"numbers and ranges such as 800-819, of at most {MOST_PEOPLE} people"
        raise UsageError("people cannot be understood", found=repr(text), expected=expected)
    return numbers
