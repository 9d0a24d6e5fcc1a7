"""The worst frames as pictures, embedded."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import TypeAlias

from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.html.markup import element, text
from posetrack_cli.evaluation.pictures import Picture

MOST_BYTES = 3_500_000
"""Of all pictures of a page together; base64 makes them 4.7 MB, and half of 10 MB is for the plots."""


NO_FRAMES = "No pictures: there are no frames."
NO_RECORDING = (
    "No pictures: the recording that the result was made from was not at hand when this page was written. "
    'They are drawn where it lies beside the result or is named: <code class="option">--recording</code>.'
)

Pictures: TypeAlias = Mapping[str, Sequence[Picture]]


def fitting(evaluations: Sequence[Evaluation], pictures: Pictures) -> tuple[Pictures, int]:
    """Return the pictures that fit into ``MOST_BYTES``, the first of each result first; how many do not."""
    kept: dict[str, list[Picture]] = {one.name: [] for one in evaluations}
    rest, dropped = MOST_BYTES, 0
    longest = max((len(pictures.get(name, ())) for name in kept), default=0)
    for place in range(longest):
        for name in kept:
            given = pictures.get(name, ())
            if place >= len(given):
                continue
            if len(given[place].png) > rest:
                dropped += 1
            else:
                kept[name].append(given[place])
                rest -= len(given[place].png)
    return kept, dropped


def gallery(evaluations: Sequence[Evaluation], pictures: Pictures, dropped: int) -> str:
    """Return one group of figures per result; scripts show the group of the chosen one."""
    groups = [
        element("div", _group(one, pictures.get(one.name, ())), class_="gallery", data_result=place)
        for place, one in enumerate(evaluations)
    ]
    note = f"{dropped} more pictures were left out to keep the page small." if dropped else ""
    return "".join(groups) + (element("p", text(note), class_="remark") if note else "")


def _group(evaluation: Evaluation, pictures: Sequence[Picture]) -> str:
    if not pictures:
        why = NO_RECORDING if evaluation.coverage.frames else NO_FRAMES
        return element("p", why, class_="missing")
    return "".join(_figure(place, one) for place, one in enumerate(pictures))


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
