"""Which recordings a batch is of."""

from __future__ import annotations

import glob
import os
from pathlib import Path

import pytest

from posetrack_cli import limits
from posetrack_cli.batch.sources import Search, find_sources
from posetrack_cli.errors import UsageError


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name in ("in/a.mcap", "in/day1/b.mcap", "in/day2/b.mcap", "in/images/0.png", "in/notes.md"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    return tmp_path


def names(*given: str) -> list[str]:
    return [source.name for source in find_sources(given)]


def test_patterns_name_results_by_what_is_below_them(folder: Path) -> None:
    assert names("in/**/*.mcap") == ["a", "day1/b", "day2/b"]
    assert names("in/day1/*.mcap") == ["b"]
    assert names("in/images", "in/a.mcap") == ["images", "a"]
    assert names("in/ima*") == ["images"]


def test_a_folder_of_ros_2_is_one_recording(folder: Path) -> None:
    for name in ("in/bag/metadata.yaml", "in/bag/bag_0.mcap", "in/bag/bag_1.mcap"):
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_bytes(b"")
    assert names("in/b*") == ["bag"]
    assert names("in/**") == ["a", "bag", "day1/b", "day2/b", "images/0", "notes"]


def test_results_are_no_recordings(folder: Path) -> None:
    """A pattern of everything finds them, too, once there are some."""
    for name in ("out/a.mcap", "out/.batch/a.pieces/00000.mcap"):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_bytes(b"")
    found = find_sources(["**/*.mcap"], Path("out"))
    assert [one.name for one in found] == ["in/a", "in/day1/b", "in/day2/b"]


def test_a_file_of_signs_is_no_pattern(folder: Path) -> None:
    Path("in/x[1].mcap").write_bytes(b"")
    assert names("in/x[1].mcap") == ["x[1]"]


def test_lists_are_read_relative_to_themselves(folder: Path) -> None:
    Path("in/list.txt").write_text("# all of them\na.mcap\nday*/b.mcap  # by pattern\n\n")
    found = find_sources(["in/list.txt"])
    assert [one.name for one in found] == ["a", "day1/b", "day2/b"]
    assert [one.path for one in found] == [Path("in/a.mcap"), Path("in/day1/b.mcap"), Path("in/day2/b.mcap")]


def test_a_manifest_gives_each_recording_its_own(folder: Path) -> None:
    Path("in/camera.toml").write_text("")
    Path("in/truth.csv").write_text("")
    Path("in/set.toml").write_text(
        'gates = ["coverage < 0.9"]\n[options]\nseed = 3\ncamera = "camera.toml"\n'
        '[[recordings]]\npath = "a.mcap"\nname = "first/a"\ntruth = "truth.csv"\n'
        "[recordings.options]\nseed = 4\nsmooth = true\n"
        '[[recordings]]\npath = "day*/b.mcap"\nperson = "p1"\ngates = ["lost > 3"]\n'
    )
    first, second, third = find_sources(["in/set.toml"])
    assert (first.name, first.truth) == ("first/a", Path("in/truth.csv"))
    assert first.options == {"seed": 4, "camera": "in/camera.toml", "smooth": True}
    assert (second.name, third.name) == ("day1/b", "day2/b")
    assert [one.person for one in (first, second, third)] == ["", "p1", "p1"]
    assert second.options == {"seed": 3, "camera": "in/camera.toml"}
    assert second.gates == ("coverage < 0.9", "lost > 3")


OUTSIDE = {
    "model": 'detector-model = "../model.onnx"',
    "model, by its whole name": 'face-model = "{here}/model.onnx"',
    "model, relative to where batch runs": 'hand-mesh = "./model.onnx"',
    "link": 'load-model = "link.onnx"',
    "one of several configurations": 'config = ["own.toml", "../other.toml"]',
    "model of a configuration": 'config = "bad.toml"',
    "assignment": 'set = ["start.detection.model={here}/model.onnx"]',
    "assignment of a table": """set = ['start={{detection={{model="{here}/model.onnx"}}}}']""",
}


@pytest.mark.parametrize("name", OUTSIDE)
def test_models_and_configurations_of_a_manifest_lie_in_its_folder(folder: Path, name: str) -> None:
    here = folder.resolve()
    (folder / "model.onnx").write_bytes(b"")
    (folder / "other.toml").write_text("")
    (folder / "in/own.toml").write_text("")
    (folder / "in/bad.toml").write_text('[start.detection]\nmodel = "../model.onnx"\n')
    (folder / "in/link.onnx").symlink_to(here / "model.onnx")
    line = OUTSIDE[name].format(here=here)
    (folder / "in/set.toml").write_text(f'[options]\n{line}\n[[recordings]]\npath = "a.mcap"\n')
    with pytest.raises(
        UsageError, match=r"in/set.toml: option '.*' refers to a file outside the manifest's folder"
    ):
        find_sources(["in/set.toml"])


def test_models_and_configurations_in_a_manifest_s_folder_and_shipped_ones_are_named(folder: Path) -> None:
    (folder / "in/models").mkdir()
    (folder / "in/models/m.onnx").write_bytes(b"")
    (folder / "in/own.toml").write_text('[start.detection]\nmodel = "models/m.onnx"\n')
    (folder / "in/set.toml").write_text(
        '[options]\nconfig = ["own.toml", "hand-paper"]\ndetector-model = "models/m.onnx"\nshape = "average"'
        '\nset = ["filter.particles=8"]\n[[recordings]]\npath = "a.mcap"\n'
    )
    (source,) = find_sources(["in/set.toml"])
    assert source.options == {
        "config": ["in/own.toml", "hand-paper"],
        "detector-model": "in/models/m.onnx",
        "shape": "average",
        "set": ["filter.particles=8"],
    }


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("recordings = []", "manifest lists no recording"),
        (
            '[[recordings]]\npath = "a.mcap"\nside = "left"',
            "unknown configuration key 'recordings.0.side'; known:",
        ),
        ('[[recordings]]\npaht = "a.mcap"', "'recordings.0.path' is missing"),
        ('[[recordings]]\npath = "gone.mcap"', "in/gone.mcap: no such recording"),
        ('[[recordings]]\npath = "day*/b.mcap"\nname = "x"', "name 'x' is given to several recordings"),
        ('[[recordings]]\npath = "a.mcap"\nname = "../x"', "invalid result name"),
        ('[[recordings]]\npath = "a.mcap"\nname = "/x"', "invalid result name"),
        ('[[recordings]]\npath = "a.mcap"\ntruth = "gone.csv"', "no such ground-truth file, found gone.csv"),
        ("[[recordings]\n", "not a TOML file"),
    ],
)
def test_a_manifest_that_cannot_be_meant_is_refused(folder: Path, text: str, words: str) -> None:
    Path("in/set.toml").write_text(text)
    with pytest.raises(UsageError) as caught:
        find_sources(["in/set.toml"])
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["nothing/*.mcap"], "nothing/*.mcap: no matching recording"),
        (["gone.mcap"], "gone.mcap: no such recording"),
        (["in/day1/b.mcap", "in/day2/b.mcap"], "two recordings have the same result name, b.mcap"),
        (["in/a.mcap", "in/a.mcap"], "two recordings have the same result name, a.mcap"),
    ],
)
def test_what_cannot_be_meant_is_refused(folder: Path, given: list[str], words: str) -> None:
    with pytest.raises(UsageError) as caught:
        find_sources(given)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    "pattern",
    [
        "**",
        "in/**",
        "in/**/*",
        "**/b.mcap",
        "in/*/b*",
        "in/day[12]/*",
        "**/.h*/*",
        ".hid*/**",
        "in/a.mcap/*",
        "*/day1/b.mcap",
    ],
)
def test_patterns_match_what_they_match_elsewhere(folder: Path, pattern: str) -> None:
    (folder / ".hidden").mkdir()
    (folder / ".hidden" / "c.mcap").touch()
    expected = {one.rstrip("/") for one in glob.glob(pattern, recursive=True)}  # noqa: PTH207 the reference
    assert {str(one) for one in Search().matches(Path(pattern))} - {"."} == expected - {""}


def test_links_that_form_a_ring_end_and_folders_count_once(folder: Path) -> None:
    for name in ("a", "b"):
        Path(f"in/{name}").symlink_to(".")
    Path("in/day0").symlink_to("day1")  # is found first, and keeps no recording from its own name
    assert names("in/**/*.mcap") == ["a", "day1/b", "day2/b"]
    assert names("in/day0/*.mcap") == ["b"]  # as it is named


def test_a_search_without_end_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "SEARCH_ENTRIES", 12)
    assert names("in/day*/*.mcap") == ["day1/b", "day2/b"]
    words = r"\*\*/\*\.mcap: pattern visits too many files and folders, expected at most 12; start it with"
    with pytest.raises(UsageError, match=words):
        names("**/*.mcap")
    Path("in/list.txt").write_text("day*/b.mcap\n" * 9)  # the bound is of all patterns together
    with pytest.raises(UsageError, match="too many files"):
        find_sources(["in/list.txt"])


def test_names_that_show_alike_are_refused(folder: Path) -> None:
    for name in (os.fsdecode(b"x\xff.mcap"), "x\\udcff.mcap"):
        Path("in", name).touch()
    with pytest.raises(UsageError, match="two recordings have the same result name"):
        names("in/x*.mcap")
