"""The worst frames as pictures, embedded."""

from __future__ import annotations

import base64
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.pictures import Picture, errors_of
from posetrack_cli.evaluation.viewing.frame_choice import APART_NS
from posetrack_cli.units import NS_PER_S

MOST_BYTES = 3_500_000
"""Of all pictures of a page together; base64 makes them 4.7 MB, and half of 10 MB is for the plots."""


NO_FRAMES = "No pictures: there are no frames."
NOT_DRAWN = "No pictures were drawn."
NO_ROOM = "No pictures: those of the other results take all the room there is."

WIDE = 1.5
"""Width over height of pictures that need more room than others."""
_PNG_SIZE_AT = 16
"""Where a PNG file tells its width and height."""

Pictures: TypeAlias = Mapping[str, Sequence[Picture] | str]
"""Of each result, by name, the pictures, the worst first; or a text that says why there are none."""


@dataclass(frozen=True, eq=False)
class Gallery:
    """What a page shows of the pictures it was given.

    Attributes:
        pictures: of each result, by name.
        missing: why there are none, by the name of each result without any.
        dropped: how many found no room.
    """

    pictures: Mapping[str, Sequence[Picture]]
    missing: Mapping[str, str]
    dropped: int


def fitting(evaluations: Sequence[Evaluation], pictures: Pictures) -> Gallery:
    """Choose the pictures that fit into ``MOST_BYTES``, the first of each result first."""
    given = {one.name: pictures.get(one.name, ()) for one in evaluations}
    drawn = {name: () if isinstance(found, str) else found for name, found in given.items()}
    kept: dict[str, list[Picture]] = {name: [] for name in drawn}
    rest = MOST_BYTES
    for _, name, picture in sorted(
        ((place, name, one) for name, found in drawn.items() for place, one in enumerate(found)),
        key=lambda entry: entry[0],
    ):
        if len(picture.png) <= rest:
            kept[name].append(picture)
            rest -= len(picture.png)
    missing = {one.name: _reason(one, given[one.name]) for one in evaluations if not kept[one.name]}
    return Gallery(kept, missing, sum(map(len, drawn.values())) - sum(map(len, kept.values())))


def _reason(evaluation: Evaluation, given: Sequence[Picture] | str) -> str:
    if isinstance(given, str):
        return f"No pictures: {given.rstrip('.')}."
    if given:
        return NO_ROOM
    return NOT_DRAWN if evaluation.coverage.frames else NO_FRAMES


@dataclass(frozen=True)
class Figure:
    """A picture as the page shows it.

    Attributes:
        source: the image itself, as an address.
        caption: one line.
        frame_index: position in the recording.
        width, height: pixels.
    """

    source: str
    caption: str
    frame_index: int
    width: int
    height: int


@dataclass(frozen=True)
class Group:
    """The pictures of one result.

    Attributes:
        name: of the result.
        pictures: the worst first.
        missing: why there are none.
        chosen_by: what makes them the worst.
    """

    name: str
    pictures: tuple[Figure, ...]
    missing: str
    chosen_by: str

    @property
    def is_wide(self) -> bool:
        """Whether its pictures are of several panels beside each other."""
        return any(one.width > WIDE * one.height for one in self.pictures)


def groups(evaluations: Sequence[Evaluation], gallery: Gallery) -> list[Group]:
    """Return the pictures of each result; scripts show those of the chosen one."""
    return [
        Group(
            one.name,
            tuple(map(_figure, gallery.pictures[one.name])),
            gallery.missing.get(one.name, ""),
            chosen_by(one),
        )
        for one in evaluations
    ]


def chosen_by(evaluation: Evaluation) -> str:
    """Say which frames are the worst."""
    _, error = errors_of(evaluation)
    what = (
        f"The largest {error} first"
        if error
        else "Without truth: lost frames first, then the least confidence"
    )
    truth = "" if evaluation.truth is None else " The truth is green."
    return f"{what}; at least {APART_NS / NS_PER_S:g} s apart.{truth}"


def _figure(picture: Picture) -> Figure:
    source = "data:image/png;base64," + base64.b64encode(picture.png).decode("ascii")
    width, height = struct.unpack_from(">II", picture.png, _PNG_SIZE_AT)
    return Figure(source, picture.caption, picture.frame_index, width, height)
