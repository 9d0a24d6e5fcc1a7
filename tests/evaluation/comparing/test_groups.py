"""Groups of results: who is paired with whom, and what is said about the rest."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.judging.comparing import UNCORRECTED, compare_groups, pair_by_recording, paired
from posetrack_cli.evaluation.measuring.evaluation import statistics
from posetrack_cli.evaluation.reading.tracks import Coverage
from support.evaluation import hand_evaluation

KEYS = st.lists(st.tuples(st.sampled_from("pqrst"), st.sampled_from("123")), unique=True, max_size=9)


def unit(name: str, recording: str = "p", seed: str = "1", error: float = 5.0, **changes: object):
    run = {"input.sha256": recording, "seed": seed} if recording else {}
    metrics = {"coverage": 1.0, "joint_error_mm": statistics([error])}
    return hand_evaluation(name, 2, **{"run": run, "metrics": metrics, "absent": {}, **changes})


def units(prefix: str, keys: list[tuple[str, str]]):
    return [unit(f"{prefix}{r}{s}", r, s) for r, s in keys]


def names(first, second) -> list[tuple[str, str]]:
    return [(a.name, b.name) for a, b in pair_by_recording(first, second).pairs]


def test_same_recording_and_seed_belong_together() -> None:
    a, b = units("a", [("p", "1"), ("p", "2"), ("q", "1")]), units("b", [("q", "1"), ("p", "2"), ("p", "1")])
    assert names(a, b) == [("ap1", "bp1"), ("ap2", "bp2"), ("aq1", "bq1")]


def test_one_result_each_of_a_recording_are_paired_whatever_their_seeds() -> None:
    a, b = units("a", [("p", "1"), ("q", "1")]), units("b", [("p", "7"), ("q", "8")])
    assert names(a, b) == [("ap1", "bp7"), ("aq1", "bq8")]


def test_what_has_no_partner_is_named() -> None:
    a, b = units("a", [("p", "1"), ("p", "2"), ("q", "1")]), units("b", [("p", "2"), ("p", "3"), ("r", "1")])
    pairing = pair_by_recording(a, [*b, unit("nameless", recording="")])
    assert [(x.name, y.name) for x, y in pairing.pairs] == [("ap2", "bp2")]
    assert pairing.unpaired == ("ap1", "aq1", "bp3", "br1", "nameless")


@given(KEYS, KEYS)
def test_laws_of_pairing(first: list[tuple[str, str]], second: list[tuple[str, str]]) -> None:
    a, b = units("a", first), units("b", second)
    pairing = pair_by_recording(a, b)
    used = [one.name for pair in pairing.pairs for one in pair]
    assert len(set(used)) == len(used)  # one to one
    assert sorted([*used, *pairing.unpaired]) == sorted(one.name for one in (*a, *b))  # nobody is forgotten
    assert all(x.run["input.sha256"] == y.run["input.sha256"] for x, y in pairing.pairs)
    assert {(y, x) for x, y in names(a, b)} == set(names(b, a))  # symmetric
    both = {f"a{r}{s}" for r, s in first if (r, s) in second}
    assert both <= set(used)  # who has a partner of the same recording and seed is paired with it
    assert all(x[1:] == y[1:] for x, y in names(a, b) if x in both)


def test_the_order_of_the_results_does_not_matter() -> None:
    a, b = units("a", [("p", "1"), ("p", "2"), ("q", "1")]), units("b", [("p", "1"), ("p", "2"), ("q", "3")])
    expected = set(names(a, b))
    assert all(set(names(a, list(other))) == expected for other in permutations(b))


def test_a_recording_twice_with_one_seed_is_refused() -> None:
    with pytest.raises(
        UsageError, match="'rbpf' has two results of the same recording and seed, found x and y"
    ):
        compare_groups({"rbpf": [unit("x"), unit("y")], "pf": [unit("z")]})


def test_different_subjects_are_refused() -> None:
    with pytest.raises(UsageError, match="different subjects cannot be compared, found hand and head"):
        compare_groups({"a": [unit("x")], "b": [unit("y", subject="head")]})


def test_figures_of_groups_and_their_differences() -> None:
    first = [4.0, 6.0, 5.0, 9.0, 3.0, 8.0, 7.0]
    second = [3.0, 4.0, 4.0, 7.0, 3.5, 6.0, 4.0]
    a = [unit(f"a{i}", f"r{i}", error=error) for i, error in enumerate(first)]
    b = [unit(f"b{i}", f"r{i}", error=error) for i, error in reversed(list(enumerate(second)))]
    comparison = compare_groups({"rbpf": a, "pf": b})
    assert comparison.groups["rbpf"]["joint_error_mm.mean"] == statistics(first)
    assert comparison.groups["pf"]["joint_error_mm.mean"].mean == pytest.approx(np.mean(second))
    found = {d.figure: d for d in comparison.differences}
    assert found["joint_error_mm.mean"].paired == paired(first, second)
    assert found["coverage"].paired.p_value == 1.0 and found["coverage"].note == "no pair differs"
    assert comparison.unit == "one recording"


def test_a_lost_track_counts_in_its_group() -> None:
    lost = unit("lost", "q", error=400.0, coverage=Coverage(9, 0, 9, 0, 0, 0, 0, True, 0))
    comparison = compare_groups({"a": [unit("x"), lost], "b": [unit("y"), unit("z", "q")]})
    assert comparison.groups["a"]["joint_error_mm.mean"].max == 400.0
    assert comparison.differences[1].paired.count == 2


def test_notes_say_how_pairs_were_found() -> None:
    a = units("a", [("p", "1"), ("p", "2"), ("q", "1")])
    comparison = compare_groups({"a": a, "b": units("b", [("p", "1"), ("p", "2"), ("q", "9"), ("r", "1")])})
    assert list(comparison.notes[:3]) == [
        "b - a: unpaired (no result of the same recording and seed): br1",
        "b - a: seeds differ, so results are paired by recording only",
        "b - a: 3 pairs of 2 recordings are not all independent",
    ]


def test_pairs_of_the_same_seed_and_of_different_recordings_need_no_note() -> None:
    keys = [("p", "1"), ("q", "1"), ("r", "2")]
    assert compare_groups({"a": units("a", keys), "b": units("b", keys)}).notes == (UNCORRECTED,)


def test_nothing_is_said_about_pairs_where_there_are_none() -> None:
    comparison = compare_groups({"a": units("a", [("p", "1")]), "b": units("b", [("q", "2")])})
    assert comparison.notes == (
        "b - a: unpaired (no result of the same recording and seed): ap1, bq2",
        UNCORRECTED,
    )
    assert {one.paired.count for one in comparison.differences} == {0}


def test_each_group_is_compared_with_the_first() -> None:
    comparison = compare_groups({name: [unit(name)] for name in ("a", "b", "c")})
    assert {(d.first, d.second) for d in comparison.differences} == {("a", "b"), ("a", "c")}


def test_figures_that_no_result_has_are_no_rows() -> None:
    groups = {"a": [unit("a1")], "b": [unit("b1")]}
    found = compare_groups(groups)
    assert set(found.groups["a"]) == {"coverage", "joint_error_mm.mean", "joint_error_mm.p95"}
    assert [one.figure for one in found.differences] == [
        "coverage",
        "joint_error_mm.mean",
        "joint_error_mm.p95",
    ]


@pytest.mark.parametrize("lacking", ["a", "b"])
def test_a_pair_of_which_one_lacks_a_figure_is_left_out_and_told(lacking: str) -> None:
    without = {"metrics": {"coverage": 0.0}, "absent": {"joint_error_mm": "no frame has a truth"}}
    groups = {
        name: [unit(f"{name}p", "p"), unit(f"{name}q", "q", **(without if name == lacking else {}))]
        for name in "ab"
    }
    found = compare_groups(groups)
    counts = {one.figure: one.paired.count for one in found.differences}
    assert counts == {"coverage": 2, "joint_error_mm.mean": 1, "joint_error_mm.p95": 1}
    notes = {one.figure: one.note for one in found.differences}
    assert f"without {lacking}q (no frame has a truth)" in notes["joint_error_mm.mean"]
    assert found.groups[lacking]["joint_error_mm.mean"].count == 1
