"""Recordings that are links into a store, as DVC and git-annex keep them, are found by the link's name."""

from __future__ import annotations

from pathlib import Path

import pytest

from posetrack_cli.evaluation.reading.recording_of import search_recording
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results.reader import read_result
from support.bags import write_bag, write_folder
from support.viewing import make_result


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_link_is_found_beside_its_result(tmp_path: Path, kind: str) -> None:
    store, work = tmp_path / "store" / "3f", tmp_path / "work"
    store.mkdir(parents=True)
    work.mkdir()
    stored = store / "a1b2c3"
    if kind == "file":
        write_bag(tmp_path / "r.bag").rename(stored)
    else:
        write_folder(stored, "sqlite3")
    recording = work / "recording"
    recording.symlink_to(Path("../store/3f/a1b2c3"))
    opened = open_recording(recording)
    assert opened.identity()["name"] == "recording"
    result = read_result(make_result(work / "result.mcap", opened))
    found = search_recording(result)
    assert found.recording is not None and found.recording.path == recording, found.reason
