"""Every attack that once worked, again: small files made here, and commands that are given them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hostile import corpus
from hostile.case import Case
from hostile.corpus import CORPUS, damaged_json, damaged_npz
from hostile.invariant import violations
from hostile.running import Harness
from hostile.seeds import Seeds
from hostile.targets import HEAD, OUT

SLACK = 3.0
"""Seconds of CPU are longer while other tests share a core."""


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


@pytest.mark.parametrize("kind", ["hand", "stereo", "mono"])
def test_damaged_states(kind: str, harness: Harness, seeds: Seeds) -> None:
    """A damaged state is refused in one line, or leads to the bytes of a run that was not interrupted."""
    part, state = seeds.interrupted[kind]
    recording = {"hand.mcap": seeds.hand, "heads.mcap": seeds.heads}
    command = (*seeds.commands[kind], "-o", "out.mcap", "--resume")
    failures = []
    for name, damaged in [*damaged_npz(state), *damaged_json(state, "json.npy")]:
        files = {n: data for n, data in recording.items() if n in command}
        case = Case("states", command, {**files, "out.mcap.part": part, "out.mcap.part.state": damaged}, OUT)
        made, outcome = harness.run_and_read(case)
        failures += [f"{name}: {line}" for line in violations(case, outcome, slack=SLACK)]
        if outcome.code == 0 and made["out.mcap"] != seeds.results[kind]:
            failures.append(f"{name}: resumed to other bytes")
        if outcome.code != 0 and made.get("out.mcap.part") != part:
            failures.append(f"{name}: the unfinished result was changed")
    assert failures == []


def models(seeds: Seeds) -> Iterator[tuple[str, tuple[str, ...], bytes]]:
    tail = ("heads.mcap", "-o", "out.mcap", *HEAD)
    mono = ("head", "mono", *tail, "--cameras", "left", "--passes", "1")
    stereo = ("head", "stereo", *tail)
    yield "mono", (*mono, "--load-model", "m.npz"), seeds.models["mono"]
    yield "stereo", (*stereo, "--load-model", "m.npz"), seeds.models["stereo"]
    yield "face", (*mono, "--face-model", "m.npz"), seeds.face_model


def test_damaged_models(harness: Harness, seeds: Seeds) -> None:
    failures = []
    for kind, command, data in models(seeds):
        for name, damaged in [*damaged_npz(data), *damaged_json(data, "header.npy")]:
            case = Case("models", command, {"heads.mcap": seeds.heads, "m.npz": damaged}, OUT)
            failures += broken(harness, f"{kind}: {name}", case)
    assert failures == []


def test_every_item_has_its_cases() -> None:
    assert len(CORPUS) == len(set(CORPUS)) and len(corpus.CORPUS) > 200
