"""Ways to track with one camera: which model, when it is adjusted, how many passes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ModelName = Literal["all", "others", "shipped"]
PAPER = ("--config", "head-mono-paper")
FIRST, SECOND = ("--passes", "1"), ("--passes", "2")


@dataclass(frozen=True)
class Entrant:
    """A way to track.

    Attributes:
        name: what its results are called by.
        title: what tables call it.
        arguments: of ``posetrack head mono``, beside recording, camera, model and output.
        model: built from all persons, from all others than the one who is tracked, or the shipped one.
    """

    name: str
    title: str
    arguments: tuple[str, ...]
    model: ModelName = "shipped"


def adjusted(when: str) -> tuple[str, ...]:
    """Arguments that say when the face is adjusted."""
    return ("--adjust", when)


EXPERIMENTS: dict[str, tuple[ModelName, str]] = {
    "A": ("all", "always"),
    "B": ("others", "always"),
    "C": ("all", "start"),
}
"""The thesis's experiments: model, and when the face is adjusted (4.5)."""


def _of_experiment(name: str) -> tuple[Entrant, ...]:
    model, when = EXPERIMENTS[name]
    return (
        Entrant(name, f"{name}, one pass", (*adjusted(when), *FIRST), model),
        Entrant(f"{name}-2", f"{name}, two passes", (*adjusted(when), *SECOND), model),
        Entrant(f"{name}-paper", f"{name}, `head-mono-paper`", (*PAPER, *adjusted(when), *FIRST), model),
    )


POPULATION: tuple[Entrant, ...] = (
    *(entrant for name in EXPERIMENTS for entrant in _of_experiment(name)),
    Entrant("never", "never adjusted, one pass", (*adjusted("never"), *FIRST), "all"),
    Entrant("never-2", "never adjusted, two passes", (*adjusted("never"), *SECOND), "all"),
    Entrant("shipped", "shipped model, one pass", FIRST),
    Entrant("shipped-2", "shipped model, two passes", SECOND),
)
"""Of recordings of the synthetic persons."""

PEOPLE: tuple[Entrant, ...] = (
    Entrant("always", "adjusted always, one pass", FIRST),
    Entrant("always-2", "adjusted always, two passes (default)", SECOND),
    Entrant("start", "adjusted at the start, one pass", (*adjusted("start"), *FIRST)),
    Entrant("start-2", "adjusted at the start, two passes", (*adjusted("start"), *SECOND)),
    Entrant("never", "never adjusted, one pass", (*adjusted("never"), *FIRST)),
    Entrant("never-2", "never adjusted, two passes", (*adjusted("never"), *SECOND)),
    Entrant("paper", "`head-mono-paper`", (*PAPER, *FIRST)),
)
"""Of recordings of other faces, with the shipped model."""

CLIPS: tuple[Entrant, ...] = (
    Entrant("one-pass", "one pass", FIRST),
    Entrant("two-passes", "two passes (default)", SECOND),
    Entrant("paper", "`head-mono-paper`", (*PAPER, *FIRST)),
)
"""Of videos without truth, with the shipped model."""
