"""docs/benchmarks.md and README state what was measured, and nothing else."""

from __future__ import annotations

import json

import pytest

import benchmark_page
from benchmark_page import MeasurementError, collect, figures_of, page_of
from benchmarking.files import Usage
from benchmarking.files import _rows as files_rows

SOURCE = {"command": "scripts/reproduce hand", "posetrack": "1.0", "processor": "a CPU"}
STUDY = {
    "source": SOURCE,
    "targets": [["joints, mm", "<= 3", "2.43", "reached"]],
    "figures": {"default": {"all": {"error_mm": 4.168, "lost": 3.0}}},
}
BENCH = {"source": SOURCE, "rows": [{"name": "hand, tracking alone", "value": 29.4}]}
TEMPLATE = (
    "{{hand|default|all|error_mm|.1f}} mm, {{hand|asked|joints, mm}}, {{bench|hand, tracking alone|.0f}} ms"
)


def measured() -> dict[str, object]:
    found: dict[str, object] = {}
    collect(found, "hand", STUDY, TEMPLATE)
    collect(found, "bench", BENCH, TEMPLATE)
    return found


def test_what_is_committed_is_current() -> None:
    page, readme = benchmark_page.TEMPLATE.read_text(encoding="utf-8").split("\n<!-- README -->\n")
    figures = json.loads(benchmark_page.MEASURED.read_text(encoding="utf-8"))
    committed = benchmark_page.PAGE.read_text(encoding="utf-8")
    assert committed == benchmark_page.GENERATED + page_of(figures, page), "run scripts/docs, and commit it"
    assert page_of(figures, readme).strip() in benchmark_page.README.read_text(encoding="utf-8")


def test_figures_stand_where_the_template_names_them() -> None:
    assert page_of(measured(), TEMPLATE) == "4.2 mm, 2.43, 29 ms"
    assert page_of(measured(), "{{sources}}").splitlines() == [
        "| bench | `scripts/reproduce hand` | 1.0 | a CPU |",
        "| hand | `scripts/reproduce hand` | 1.0 | a CPU |",
    ]


def test_only_figures_of_the_template_are_kept_and_other_parts_stay() -> None:
    found = measured()
    assert figures_of(STUDY)["default|all|lost"] == 3.0
    assert "default|all|lost" not in json.dumps(found)
    later = STUDY | {"figures": {"default": {"all": {"error_mm": 5.0}}}, "targets": []}
    collect(found, "hand", later, TEMPLATE)
    assert page_of(found, TEMPLATE) == "5.0 mm, 2.43, 29 ms"


def test_a_figure_that_was_not_measured_is_refused() -> None:
    with pytest.raises(MeasurementError, match="mono: x is not in measured"):
        page_of(measured(), "{{mono|x|.1f}}")
    with pytest.raises(MeasurementError, match="uses none of its 3 figures"):
        collect({}, "hand", STUDY, "{{hand|other|.1f}}")


def test_figures_of_two_versions_are_not_mixed_under_one_source() -> None:
    found = measured()
    newer = {"source": SOURCE | {"posetrack": "2.0"}, "targets": []}
    with pytest.raises(MeasurementError, match=r"asked\|joints, mm is of 1"):
        collect(found, "hand", newer | {"figures": STUDY["figures"]}, TEMPLATE)
    collect(found, "hand", newer | {"figures": STUDY["figures"], "targets": STUDY["targets"]}, TEMPLATE)
    assert found["hand"]["source"]["posetrack"] == "2.0"  # type: ignore[index]


def test_whole_commands_are_one_table() -> None:
    """18 s of CPU time for 6 recorded seconds are 3 core-hours an hour, of 2 cents each."""
    runs = {"": [Usage(18.0, 12.0, 180, 6.0)], "previous version": [Usage(36.0, 12.0, 180, 6.0)]}
    rows = [vars(row) for row in files_rows("Kinect folder", runs)]
    found: dict[str, object] = {}
    collect(found, "files", {"source": SOURCE, "rows": rows}, "{{files table}}")
    lines = page_of(found, "{{files table}}").splitlines()
    assert lines[-1] == (
        "| Kinect v2 folder, 181 frames, `hand run` | 18.0 | 100.0 | 200.0 | 15.0 | 3.00 | 6.0 |"
    )
    assert {line.count("|") for line in lines[2:]} == {8}


def test_without_whole_commands_there_is_no_table() -> None:
    assert page_of(measured(), "a{{files table}}b") == "ab"
