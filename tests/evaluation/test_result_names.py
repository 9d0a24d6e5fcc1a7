"""Names of results beside each other."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.evaluation.reading.tracks import plain_name, unique_names
from support.metrics import relaxed


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("out/result.mcap", "result"),
        ("result.mcap.part", "result"),
        ("result", "result"),
        ("a.b.mcap", "a.b"),
        (".hidden", ".hidden"),
        ("ünï cödé.mcap", "ünï cödé"),
        ("two\nlines.mcap", r"two\nlines"),
        ("\x1b[31mred.mcap", r"\x1b[31mred"),
        ("no text \udcff.mcap", r"no text \udcff"),
    ],
)
def test_a_name_has_no_folder_and_no_ending(path: str, name: str) -> None:
    assert plain_name(Path(path)) == name


def test_names_stay_short_where_they_differ() -> None:
    assert unique_names([Path("x/pf.mcap"), Path("y/rbpf.mcap")]) == ["pf", "rbpf"]


def test_alike_names_get_their_folder() -> None:
    paths = [Path("pf/result.mcap"), Path("rbpf/result.mcap"), Path("other.mcap")]
    assert unique_names(paths) == ["pf/result", "rbpf/result", "other"]


def test_a_folder_is_named_also_where_the_path_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert unique_names([Path("result.mcap"), Path("sub/result.mcap")]) == ["here/result", "sub/result"]


def test_what_is_still_alike_is_numbered() -> None:
    paths = [Path("a/r.mcap"), Path("a/r.mcap"), Path("b/a/r.mcap")]
    assert unique_names(paths) == ["a/r", "a/r (2)", "a/r (3)"]


@relaxed
@given(st.lists(st.sampled_from(["a", "a (2)", "x/a", "y/a", "x/a (2)", "x/x/a", "b.part"]), max_size=8))
def test_names_are_unique_whatever_the_paths(paths: list[str]) -> None:
    names = unique_names([Path(f"{path}.mcap") for path in paths])
    assert len(set(names)) == len(names) == len(paths)
