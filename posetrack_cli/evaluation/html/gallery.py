"""The worst frames as pictures, embedded."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.html.components import element, text
from posetrack_cli.evaluation.pictures import Picture

MOST_BYTES = 3_500_000
"""Of all pictures of a page together; base64 makes them 4.7 MB, and half of 10 MB is for the plots."""


NO_FRAMES = "No pictures: there are no frames."
NOT_DRAWN = "No pictures were drawn."
NO_ROOM = "No pictures: those of the other results take all the room there is."

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


def gallery_section(evaluations: Sequence[Evaluation], gallery: Gallery) -> str:
    """Return one group of figures per result; scripts show the group of the chosen one."""
    groups = [
        element("div", _group(gallery, one.name), class_="gallery", data_result=place)
        for place, one in enumerate(evaluations)
    ]
    if gallery.dropped:
        note = f"{gallery.dropped} more pictures were left out to keep the page small."
        groups.append(element("p", text(note), class_="remark"))
    return "".join(groups)


def _group(gallery: Gallery, name: str) -> str:
    if name in gallery.missing:
        return element("p", text(gallery.missing[name]), class_="missing")
    return "".join(_figure(place, one) for place, one in enumerate(gallery.pictures[name]))


def _figure(place: int, picture: Picture) -> str:
    source = "data:image/png;base64," + base64.b64encode(picture.png).decode("ascii")
    image = f'<img src="{source}" alt="{text(picture.caption)}">'
    button = element(
        "button",
        f"Show frame {picture.frame_index} in 3-D",
        type="button",
        class_="jump",
        data_picture=place,
        hidden="hidden",
    )
    return element("figure", image + element("figcaption", text(picture.caption) + button))
