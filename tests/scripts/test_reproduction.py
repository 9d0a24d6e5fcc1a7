"""The study of scripts/reproduce: its pairs, its adjusted p-values, its words; and one real unit of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from posetrack_cli.configuration import find_configuration, load_settings
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.results import load_arrays, read_result
from reproduction import analysis, hand, report, study
from reproduction.hand import CONFIGURATIONS as ROWS
from reproduction.study import CONDITIONS, Condition
from reproduction.unit import ENTRANTS, Unit, configuration, is_current

PAIR = ("pf-union", "rbpf-union")
UNITS = {condition: condition.units(8, 150) for condition in CONDITIONS}


def measured(gain: float, condition: Condition) -> dict[tuple[str, str], analysis.Figures]:
    """Eight recordings of a condition whose errors are 10, 11, ... mm, and ``gain`` more for the second."""
    units = UNITS[condition]
    first = {(unit.name, PAIR[0]): {"joint_error_mm": 10.0 + k} for k, unit in enumerate(units)}
    second = {(unit.name, PAIR[1]): {"joint_error_mm": 10.0 + k + gain} for k, unit in enumerate(units)}
    return first | second


def test_a_pair_is_one_recording_and_conditions_stay_apart() -> None:
    figures = measured(-2.0, CONDITIONS[0]) | measured(3.0, CONDITIONS[4])
    figures.pop((UNITS[CONDITIONS[4]][2].name, PAIR[1]))
    compared = analysis.compare(figures, UNITS, PAIR, "joint_error_mm")
    assert [comparison.condition for comparison in compared] == [CONDITIONS[0], CONDITIONS[4]]
    assert [comparison.summary.count for comparison in compared] == [8, 7]
    np.testing.assert_array_equal(compared[0].differences, np.full(8, -2.0))
    np.testing.assert_array_equal(compared[1].differences, np.full(7, 3.0))


def test_without_the_metric_nothing_is_compared() -> None:
    assert analysis.compare(measured(1.0, CONDITIONS[0]), UNITS, PAIR, "velocity_error_mm_s") == []


def test_p_values_are_adjusted_for_their_number() -> None:
    """Benjamini and Hochberg by hand: p_(i) n / i, from the largest down never growing."""
    gains = (-2.0, 0.0, 3.0)
    compared = [
        comparison
        for gain, condition in zip(gains, CONDITIONS, strict=False)
        for comparison in analysis.compare(measured(gain, condition), UNITS, PAIR, "joint_error_mm")
    ]
    smallest = 2.0**-7  # of 2^8 equally likely signs, two are as extreme
    assert [comparison.summary.p_value for comparison in compared] == [smallest, 1.0, smallest]
    np.testing.assert_allclose(analysis.adjusted(compared), [1.5 * smallest, 1.0, 1.5 * smallest])


def test_the_verdict_names_the_entrant_with_the_smaller_error() -> None:
    lower, same, higher = (
        analysis.compare(measured(gain, CONDITIONS[0]), UNITS, PAIR, "joint_error_mm")[0]
        for gain in (-2.0, 0.0, 3.0)
    )
    assert analysis.verdict(lower, 0.01) == "rbpf-union is better"
    assert analysis.verdict(higher, 0.01) == "pf-union is better"
    assert analysis.verdict(same, 1.0) == analysis.verdict(lower, 0.05) == "no difference found"


def test_a_row_of_the_report_says_what_was_measured() -> None:
    compared = analysis.compare(measured(-2.0, CONDITIONS[0]), UNITS, PAIR, "joint_error_mm")
    row = list(report.study_table(compared, "mm"))[2]
    # 10..17 has mean 13.5 and sample variance (8^2 - 1) / 12 * 8 / 7 = 6
    assert "| A | 1 | pf-union | rbpf-union | 8 | 13.5 ± 2.4 | 11.5 ± 2.4 | -2.0 [-2.0, -2.0] |" in row


def test_a_unit_is_tracked_as_its_entrants_say_also_beside_one_that_fails(tmp_path: Path) -> None:
    unit, bad, entrants = Unit("A", 1.0, 3, 2), Unit("A", 1000.0, 3, 2), ("pf-paper", "rbpf-union")
    failures = study.run_units([bad, unit], entrants, tmp_path, jobs=1)
    assert len(failures) == 1 and failures[0].startswith(f"{bad.name}: ")
    paths = {entrant: unit.result(tmp_path, entrant) for entrant in entrants}
    for entrant, path in paths.items():
        configuration = read_result(path).run["configuration"]
        kind, cost = entrant.split("-")
        assert f'"kind": "{kind}"' in configuration and f'"cost": "{cost}"' in configuration
        assert len(load_arrays(path)["stamp_ns"]) == 2
        assert is_current(path, entrant) and not is_current(path, "pf-printed")
    before = [path.stat().st_mtime_ns for path in paths.values()]
    assert study.run_units([unit], entrants, tmp_path, jobs=1) == []
    assert [path.stat().st_mtime_ns for path in paths.values()] == before  # what is there is kept


def test_every_studied_entrant_is_known() -> None:
    assert set(study.STUDIED) <= set(ENTRANTS)


def test_rows_of_figures_are_called_by_the_configuration_that_runs() -> None:
    """Each title's entrants, resolved, against the shipped files that it names."""
    made = {
        title: [configuration(f"{kind}-{name}") for kind in ("pf", "rbpf")] for title, name in ROWS.items()
    }
    assert list(made) == ["hand-paper", "union cost, drawn from the motion", "hand (default)"]
    for name, title in (("hand-paper", "hand-paper"), ("hand", "hand (default)")):
        for kind, config in zip(("pf", "rbpf"), made[title], strict=True):
            options = {"filter.kind": kind, "output.mesh": "none"}
            assert config == load_settings(HandConfig, find_configuration(name), options)
    for config in made["union cost, drawn from the motion"]:
        assert (config.observation.cost, config.filter.proposal) == ("union", "marginal")


def test_the_report_says_what_each_row_ran() -> None:
    (text,) = (line for line in hand._head("renderer", 1, 2) if "hand-paper" in line)
    assert (
        "`filter.proposal=marginal`, `observation.sigma_mm=4.0`" in text
        and "`observation.cost=union`" in text
    )
    assert "*hand (default)* is `hand.toml` itself" in text
    assert text.endswith("They have 512, 256, 256 particles.")
