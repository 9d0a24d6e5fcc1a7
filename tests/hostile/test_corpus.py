"""Every attack that once worked, again: small files made here, and commands that are given them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

import pytest

from hostile.case import Case
from hostile.corpus import CORPUS, damaged_states, model_cases, state_case
from hostile.file_cases import npz_arrays, resigned
from hostile.invariant import violations
from hostile.running import Harness, Pool
from hostile.seeds import Seeds

SLACK = 3.0
"""Seconds of CPU are longer while other tests share a core."""
STATES = {"hand": 3, "stereo": 8, "mono": 8}
MODELS = 12
"""Of some hundred damaged ones, which ``scripts/fuzz`` begins with; hands take longer, as they need GL.

What each check refuses, the tests of the readers say: ``test_damaged_states`` of hand and of head,
``test_damaged_checkpoints``, ``test_learned_people``, ``test_learned_arrays``, ``test_model_file``.
"""

T = TypeVar("T")


def needs_gl(name: str) -> bool:
    """Whether an attack meets a command that opens a GL context before it can fail."""
    return name.endswith((": hand run", ": run", " as --init")) or name.startswith("pose of")


def grouped(names: Iterable[str]) -> dict[str, list[str]]:
    """Return the names of attacks by their first words: every attack, with two of its commands in turn.

    Of those that need GL one in eight is kept. ``scripts/fuzz`` begins with all of them.
    """
    names = list(names)
    attacks: dict[str, list[str]] = {}
    for name in names:
        if not needs_gl(name):
            attacks.setdefault(name.partition(": ")[0], []).append(name)
    chosen = [name for name in names if needs_gl(name)][1::8]
    for k, commands in enumerate(attacks.values()):
        chosen += {commands[(k + turn) % len(commands)]: None for turn in range(2)}
    groups: dict[str, list[str]] = {}
    for name in chosen:
        groups.setdefault(" ".join(name.split(":")[0].split()[:2]), []).append(name)
    return groups


PLAYLIST = "playlist"
ATTACKS = grouped(name for name in CORPUS if not name.startswith(PLAYLIST))


def some(values: Sequence[T], count: int) -> list[T]:
    """Return so many values, from all places."""
    return [values[k * len(values) // count] for k in range(count)] if count < len(values) else list(values)


def broken(pool: Pool, cases: Mapping[str, Case]) -> list[str]:
    """Run cases; return what they break, each with its name."""
    found = []
    for (name, case), outcome in zip(cases.items(), pool.run(cases.values()), strict=True):
        said = outcome.error.decode("utf-8", "replace")[-2000:]
        found += [f"{name}: {line}\n{said}" for line in violations(case, outcome, slack=SLACK)]
    return found


@pytest.mark.parametrize("attack", ATTACKS)
def test_attacks_that_once_worked(attack: str, pool: Pool, seeds: Seeds) -> None:
    assert broken(pool, {name: CORPUS[name](seeds) for name in ATTACKS[attack]}) == []


def test_code_in_a_schema_is_neither_run_nor_imported(harness: Harness, seeds: Seeds) -> None:
    """The first of the corpus, in a process as a user starts it."""
    case = CORPUS["ros1 code in sensor_msgs/Image: info"](seeds)
    outcome = harness.run_fresh(case)
    assert outcome.after == outcome.before  # nothing wrote ``pwned``
    assert violations(case, outcome) == []
    warm = harness.run(case)
    assert warm.modules == () and warm.events == ()


def test_a_playlist_is_not_followed(pool: Pool, seeds: Seeds) -> None:
    cases = {name: build(seeds) for name, build in CORPUS.items() if name.startswith(PLAYLIST)}
    outcomes = dict(zip(cases, pool.run(cases.values()), strict=True))
    assert {name: outcome.code for name, outcome in outcomes.items()} == dict.fromkeys(cases, 1)
    assert [line for name in cases for line in violations(cases[name], outcomes[name], slack=SLACK)] == []


@pytest.mark.parametrize("kind", STATES)
def test_damaged_states(kind: str, pool: Pool, seeds: Seeds) -> None:
    """A damaged state is refused in one line, or leads to the bytes of a run that was not interrupted.

    With a digest that fits it is met by the checks behind that, which know only what cannot be.
    """

    def attempt(harness: Harness, damaged: tuple[str, Callable[[], bytes]]) -> list[str]:
        name, make = damaged
        return resumed(harness, seeds, kind, name, make(), same="signed" not in name)

    chosen = some(damaged_states(seeds, kind), STATES[kind])
    assert [line for found in pool.map(attempt, chosen) for line in found] == []


def test_a_whole_state_leads_to_the_same_bytes_and_keeps_its_digest(harness: Harness, seeds: Seeds) -> None:
    for kind, (_, state) in seeds.interrupted.items():
        assert resumed(harness, seeds, kind, kind, state, same=True) == []
        assert npz_arrays(resigned(state)) == npz_arrays(state)


def resumed(
    harness: Harness, seeds: Seeds, kind: str, name: str, state: bytes, *, same: bool = False
) -> list[str]:
    """Resume a run by a state; return what that breaks, also if it ends with other bytes."""
    case = state_case(seeds, kind, state)
    made, outcome = harness.run_and_read(case)
    found = [f"{name}: {line}" for line in violations(case, outcome, slack=SLACK)]
    if same and outcome.code == 0 and made["out.mcap"] != seeds.results[kind]:
        found.append(f"{name}: resumed to other bytes")
    if outcome.code in (1, 2) and made.get("out.mcap.part") != case.files["out.mcap.part"]:
        found.append(f"{name}: the unfinished result was changed")
    return found


def test_damaged_models(pool: Pool, seeds: Seeds) -> None:
    assert broken(pool, dict(some(list(model_cases(seeds)), MODELS))) == []
