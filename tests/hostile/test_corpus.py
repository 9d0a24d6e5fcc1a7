"""Every attack that once worked, again: small files made here, and commands that are given them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import pytest

from hostile.case import Case
from hostile.corpus import CORPUS, damaged_states, model_cases, state_case
from hostile.file_cases import npz_arrays, resigned
from hostile.invariant import violations
from hostile.running import Harness
from hostile.seeds import Seeds

SLACK = 3.0
"""Seconds of CPU are longer while other tests share a core."""
STATES = {"hand": 8, "stereo": 40, "mono": 40}
MODELS = 40
"""Of some hundred damaged ones, which ``scripts/fuzz`` begins with; hands take longer, as they need GL."""

T = TypeVar("T")


def some(values: Sequence[T], count: int) -> list[T]:
    """Return so many values, from all places."""
    return [values[k * len(values) // count] for k in range(count)] if count < len(values) else list(values)


def broken(harness: Harness, name: str, case: Case) -> list[str]:
    """Run a case; return what it breaks, with its name."""
    outcome = harness.run(case)
    said = outcome.error.decode("utf-8", "replace")[-2000:]
    return [f"{name}: {line}\n{said}" for line in violations(case, outcome, slack=SLACK)]


@pytest.mark.parametrize("name", CORPUS)
def test_attacks_that_once_worked(name: str, harness: Harness, seeds: Seeds) -> None:
    assert broken(harness, name, CORPUS[name](seeds)) == []


def test_code_in_a_schema_is_neither_run_nor_imported(harness: Harness, seeds: Seeds) -> None:
    """The first of the corpus, in a process as a user starts it."""
    case = CORPUS["ros1 code in sensor_msgs/Image: info"](seeds)
    outcome = harness.run_fresh(case)
    assert outcome.after == outcome.before  # nothing wrote ``pwned``
    assert violations(case, outcome) == []
    warm = harness.run(case)
    assert warm.modules == () and warm.events == ()


@pytest.mark.parametrize("name", [name for name in CORPUS if name.startswith("playlist")])
def test_a_playlist_is_not_followed(name: str, harness: Harness, seeds: Seeds) -> None:
    assert harness.run(CORPUS[name](seeds)).code == 1


@pytest.mark.parametrize("kind", STATES)
def test_damaged_states(kind: str, harness: Harness, seeds: Seeds) -> None:
    """A damaged state is refused in one line, or leads to the bytes of a run that was not interrupted.

    With a digest that fits it is met by the checks behind that, which know only what cannot be.
    """
    failures = []
    for name, state in some(damaged_states(seeds, kind), STATES[kind]):
        failures += resumed(harness, seeds, kind, name, state, same="signed" not in name)
    assert failures == []


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


def test_damaged_models(harness: Harness, seeds: Seeds) -> None:
    failures = []
    for name, case in some(list(model_cases(seeds)), MODELS):
        failures += broken(harness, name, case)
    assert failures == []
