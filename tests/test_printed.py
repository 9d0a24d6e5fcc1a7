"""Where paper configurations differ from print: what a run record and docs/method.md say of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from posetrack_cli.configuration import Settings, find_configuration, load_settings
from posetrack_cli.hand import config as hand
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.head import config as head
from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig
from posetrack_cli.tracking.options import Deviation, PrintedSetting, deviations

PAPERS: dict[str, tuple[type[Settings], Sequence[PrintedSetting], Sequence[Deviation]]] = {
    "hand-paper": (HandConfig, hand.SETTINGS, hand.ALWAYS),
    "head-stereo-paper": (
        HeadStereoConfig,
        (*head.STEREO, *head.BOTH),
        (*head.ALWAYS_STEREO, *head.ALWAYS_BOTH),
    ),
    "head-mono-paper": (
        HeadMonoConfig,
        (*head.MONO, *head.BOTH),
        (head.SHIPPED_MODEL, *head.ALWAYS_MONO, *head.ALWAYS_BOTH),
    ),
}
papers = pytest.mark.parametrize("name", PAPERS)


def stated(config: Settings) -> list[str] | None:
    if isinstance(config, HandConfig):
        return hand.deviations_from_print(config)
    assert isinstance(config, HeadStereoConfig | HeadMonoConfig)
    return head.deviations_from_print(config)


@papers
def test_a_paper_configuration_differs_only_where_no_key_helps(name: str) -> None:
    kind, settings, always = PAPERS[name]
    config = load_settings(kind, find_configuration(name), {})
    assert stated(config) == [f"{one.where}: {one.text}" for one in always]
    assert deviations(config, settings, ()) == []


@papers
def test_every_setting_that_is_changed_back_is_stated(name: str) -> None:
    """Each key alone: defaults differ from print, or the configuration need not set them."""
    kind, settings, _ = PAPERS[name]
    printed, usual = load_settings(kind, find_configuration(name), {}), kind()
    for one in settings:
        values = printed.model_dump()
        *tables, last = one.key.split(".")
        table, default = values, usual
        for part in tables:
            table, default = table[part], getattr(default, part)
        table[last] = getattr(default, last)
        if table[last] is None or kind.model_validate(values) == printed:
            continue
        changed = deviations(kind.model_validate(values), settings, ())
        (line,) = changed
        assert line.startswith(f"{one.where}: {one.key} is ")
        assert str(getattr(default, last)) in line and str(one.value) in line


@pytest.mark.parametrize("kind", [HandConfig, HeadStereoConfig, HeadMonoConfig])
def test_other_configurations_follow_no_paper(kind: type[Settings]) -> None:
    assert stated(kind()) is None


def test_a_second_pass_and_a_model_of_its_own_are_seen() -> None:
    path = find_configuration("head-mono-paper")
    lines = stated(load_settings(HeadMonoConfig, path, {"run.passes": 2, "model.file": "face.npz"}))
    assert lines is not None
    assert lines[0] == "3.4, 4.5: run.passes is 2, not 1"
    assert not any("ICT-FaceKit" in line for line in lines)


@papers
def test_the_method_page_has_every_item(name: str) -> None:
    _, _, always = PAPERS[name]
    page = (Path(__file__).parents[1] / "docs" / "method.md").read_text(encoding="utf-8")
    for one in always:
        assert f"| {one.where} | {one.text} |" in page
