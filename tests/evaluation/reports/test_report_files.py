"""Where reports may be written, and which files a group's pattern means."""

from __future__ import annotations

from pathlib import Path

import pytest

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.evaluation.judging.comparing import expand_groups
from posetrack_cli.evaluation.reports.report_files import check_reports, write_report


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name in ("rbpf-2.mcap", "rbpf-1.mcap", "pf-1.mcap", "odd[1].mcap", "sub/rbpf-3.mcap"):
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).touch()
    return tmp_path


def named(*names: str) -> tuple[Path, ...]:
    return tuple(Path(name) for name in names)


def test_patterns_are_expanded_in_order_of_names(files: Path) -> None:
    groups = expand_groups(["rbpf = rbpf-*.mcap", "pf=pf-?.mcap"])
    assert groups == {"rbpf": named("rbpf-1.mcap", "rbpf-2.mcap"), "pf": named("pf-1.mcap")}


def test_a_name_that_comes_again_adds_files_each_once(files: Path) -> None:
    assert expand_groups(["a=rbpf-1.mcap", "a=rbpf-*.mcap", "a=**/rbpf-3.mcap"]) == {
        "a": named("rbpf-1.mcap", "rbpf-2.mcap", "sub/rbpf-3.mcap")
    }


def test_an_input_that_is_a_link_to_itself_is_no_report(files: Path) -> None:
    """That it cannot be read is told by whoever reads it; ``Path.resolve`` raised RuntimeError."""
    Path("ring.mcap").symlink_to("ring.mcap")
    check_reports(named("report.json"), named("ring.mcap"), overwrite=False)
    with pytest.raises(UsageError, match="overwrite an input"):
        check_reports(named("ring.mcap"), named("ring.mcap"), overwrite=True)


def test_a_file_s_own_brackets_are_no_pattern(files: Path) -> None:
    assert expand_groups(["a=odd[1].mcap"]) == {"a": named("odd[1].mcap")}


def test_folders_are_no_results(files: Path) -> None:
    with pytest.raises(UsageError, match="no file matches the pattern of group 'a', found su"):
        expand_groups(["a=su*"])


@pytest.mark.parametrize("text", ["a", "=x", "a=", " = "])
def test_what_is_no_group(files: Path, text: str) -> None:
    with pytest.raises(
        UsageError, match=r"invalid group .*, expected NAME=PATTERN; e.g. rbpf='out/rbpf-\*.mcap'"
    ):
        expand_groups([text])


def test_a_pattern_may_hold_an_equals_sign(files: Path) -> None:
    Path("n=5.mcap").touch()
    assert expand_groups(["a=n=5.mcap"]) == {"a": named("n=5.mcap")}


def test_one_file_under_two_names_is_found_out(files: Path) -> None:
    with pytest.raises(UsageError, match="file is in two groups, found a and b"):
        expand_groups(["a=rbpf-1.mcap", f"b={files}/rbpf-1.mcap"])


def test_a_link_to_an_input_is_the_input(files: Path) -> None:
    Path("report.json").symlink_to("pf-1.mcap")
    with pytest.raises(UsageError, match="would overwrite an input"):
        check_reports(named("report.json"), named("pf-1.mcap"), overwrite=True)


def test_a_report_that_is_there_needs_overwrite(files: Path) -> None:
    with pytest.raises(UsageError, match="already exists; use --overwrite"):
        check_reports(named("pf-1.mcap"), [], overwrite=False)
    check_reports(named("pf-1.mcap"), [], overwrite=True)


def test_a_report_whose_folder_is_missing_or_that_is_one(files: Path) -> None:
    with pytest.raises(ResultError, match="no folder nowhere"):
        check_reports(named("nowhere/r.json"), [], overwrite=False)
    with pytest.raises(UsageError, match="sub: report cannot be written, found a folder"):
        check_reports(named("sub"), [], overwrite=True)


def test_a_device_is_not_replaced(files: Path) -> None:
    with pytest.raises(UsageError, match="found a device; use - for standard output"):
        check_reports(named("/dev/null"), [], overwrite=True)


def test_a_report_is_written_whole(files: Path) -> None:
    write_report(Path("r.json"), "a\u624b\udcff")
    assert Path("r.json").read_bytes() == "a\u624b".encode() + rb"\udcff"
    assert not Path("r.json.part").exists()
