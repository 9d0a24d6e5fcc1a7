"""The page's text: what it says, that it harms nobody, that it is written whole or not at all."""

from __future__ import annotations

import base64
import dataclasses
import filecmp
import json
import os
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.evaluation.html import components as gallery
from posetrack_cli.evaluation.html import packing, rows_page, write_html, writer
from posetrack_cli.evaluation.html.page_data import budget_for
from posetrack_cli.evaluation.html.writer import ReportPage, html_page
from posetrack_cli.evaluation.judging.comparing import compare
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.reading.tracks import Coverage
from posetrack_cli.losses import Loss
from support.evaluation import hand_evaluation
from support.html import NASTY, PNG, head_evaluation, picture, shortened, without_truth

VOID = {"meta", "link", "input", "img", "br"}


class Outline(HTMLParser):
    """Elements, attributes and text of a page; fails where elements are not closed in order."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text: dict[str, str] = {}
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        place = self.open[-1] if self.open else ""
        self.text[place] = self.text.get(place, "") + data

    @property
    def words(self) -> str:
        """All that a person reads without scripts."""
        return " ".join(text for place, text in self.text.items() if place not in ("script", "style"))


def page(*evaluations: Evaluation, **given: Any) -> str:
    return html_page(
        ReportPage(evaluations, given.get("comparison"), given.get("pictures", {}), given.get("title", "T"))
    )


def data_of(text: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="report-data">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    data: dict[str, Any] = json.loads(found[1])
    return data


def cells(text: str, label: str) -> list[str]:
    """The cells of the table row with this label."""
    for row in re.findall(r"<tr[^>]*>(.*?)</tr>", text):
        plain = [re.sub(r"<[^>]*>", "", cell) for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row)]
        if plain and plain[0] == label:
            return plain[1:]
    raise AssertionError(f"no row {label}")


def test_the_table_has_the_evaluation_s_figures() -> None:
    evaluation = hand_evaluation(frames=20)
    text = page(evaluation)
    value = evaluation.metrics["joint_error_mm"]
    assert not isinstance(value, float)
    assert [float(cell) for cell in cells(text, "joint error mm")[:5]] == pytest.approx(
        [value.mean, value.sd, value.median, value.p95, value.max],
        rel=5e-4,  # four digits are shown
    )
    assert cells(text, "coverage")[0] == "1"
    assert text.index(">coverage<") < text.index(">joint error<")


def test_several_results_have_a_column_each_and_their_differences() -> None:
    one, two = (
        dataclasses.replace(hand_evaluation(name, 150, error), run={"input.sha256": "same"})
        for name, error in (("a", 3.0), ("b", 9.0))
    )
    text = page(one, two, comparison=compare([one, two]))
    assert len(cells(text, "joint error, mean mm")) == 2
    words = Outline(text).words
    assert "Paired differences" in words and "b - a" in words


@pytest.mark.parametrize(
    "nasty", [NASTY, "--><!--", "${title}", "{{ title }}{% raw %}{# ", "\x00\x1b[2J", "\ud800"]
)
def test_nothing_that_a_user_names_becomes_part_of_the_page(nasty: str) -> None:
    def words(count: int) -> tuple[str, ...]:
        return tuple(f"{nasty}{i}" for i in range(count))

    track = hand_evaluation(frames=3).track
    evaluation = dataclasses.replace(
        hand_evaluation(frames=3),
        name=nasty,
        path=Path("folder") / nasty.replace("/", "").replace("\x00", ""),
        run={"configuration": json.dumps({nasty: {nasty: nasty}}), nasty: nasty, "input.name": nasty},
        notes=(nasty,),
        absent={"velocity_error_mm_s": nasty},
        losses=(Loss(nasty, 1, nasty),),
        track=dataclasses.replace(track, point_names=words(21), shape_names=words(15)),
    )
    text = page(evaluation, title=nasty, pictures={nasty: [dataclasses.replace(picture(), caption=nasty)]})
    text.encode("utf-8", "backslashreplace")
    plain = page(hand_evaluation(frames=3), pictures={"a": [picture()]})
    outline, usual = Outline(text), Outline(plain)
    assert not outline.open
    for harmful in ("img", "script", "iframe", "style"):
        names = [name for name, _ in outline.elements]
        assert names.count(harmful) == [name for name, _ in usual.elements].count(harmful)
    assert not any(key.startswith("on") for _, attributes in outline.elements for key in attributes)
    assert data_of(text)["results"][0]["name"] == nasty


def test_a_page_names_no_address_and_forbids_connections() -> None:
    text = page(hand_evaluation(frames=3), pictures={"a": [picture()]})
    outline = Outline(text)
    for _, attributes in outline.elements:
        for key in ("src", "href"):
            assert (attributes.get(key) or "data:").startswith(("data:", "#"))
    policy = next(a["content"] for n, a in outline.elements if a.get("http-equiv"))
    assert policy is not None and policy.startswith("default-src 'none'")
    assert "unsafe" not in policy
    addresses = set(re.findall(r"https?://[^\s\"'`]+", text))
    assert addresses <= {"http://www.w3.org/2000/svg"}  # a name, not a place


def test_the_same_evaluation_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one.html", "two.html"):
        write_html(tmp_path / name, ReportPage([hand_evaluation(frames=30)], None, {"a": [picture()]}, "T"))
    assert filecmp.cmp(tmp_path / "one.html", tmp_path / "two.html", shallow=False)


def test_what_must_be_known_stands_above_the_figures() -> None:
    evaluation = dataclasses.replace(
        hand_evaluation(frames=5),
        notes=("a rigid offset was removed",),
        losses=(Loss("the file ends in a message", 2, "byte 99"),),
    )
    text = page(evaluation)
    assert text.index("a rigid offset was removed") < text.index("<h2>Summary")
    assert text.index("the file ends in a message: 2, first byte 99") < text.index("<h2>Summary")


def test_absent_metrics_are_named_with_their_reason() -> None:
    assert "the truth has no velocity: velocity_error_mm_s" in re.sub(
        "<[^>]*>", "", page(hand_evaluation(frames=5))
    )


def test_configuration_and_provenance_are_told_and_differences_marked() -> None:
    runs = [
        {"seed": seed, "input.sha256": "abc", "configuration": json.dumps({"filter": {"particles": n}})}
        for seed, n in (("1", 512), ("2", 512))
    ]
    text = page(
        *(
            dataclasses.replace(hand_evaluation(name, 5), run=run)
            for name, run in zip("ab", runs, strict=True)
        )
    )
    assert cells(text, "filter.particles") == ["512", "512"]
    assert cells(text, "input.sha256") == ["abc", "abc"]
    assert cells(text, "seed differs") == ["1", "2"]


@pytest.mark.parametrize("configuration", ["", "{not json", "[1, 2]", "{}", '{"a": NaN}'])
def test_a_damaged_configuration_is_shown_as_it_is(configuration: str) -> None:
    evaluation = dataclasses.replace(hand_evaluation(frames=2), run={"configuration": configuration})
    assert not Outline(page(evaluation)).open


def test_pages_of_little() -> None:
    whole = hand_evaluation(frames=9)
    lost = dataclasses.replace(
        whole,
        coverage=Coverage(9, 0, 9, 0, 0, 0, 0, True, 0),
        track=dataclasses.replace(whole.track, lost=np.ones(9, dtype=np.bool_)),
    )
    empty = dataclasses.replace(without_truth(shortened(whole, 0)), metrics={"coverage": 0.0})
    assert "has no estimates" in page(empty)
    assert data_of(page(empty))["results"][0]["scene"] is None
    assert "No ground truth" in page(without_truth(whole))
    assert data_of(page(lost))["results"][0]["lost"] == [[0.0, pytest.approx(8 / 30, abs=1e-3)]]
    assert data_of(page(shortened(whole, 1)))["results"][0]["frames"] == 1
    for evaluation in (empty, without_truth(whole), lost, shortened(whole, 1)):
        assert not Outline(page(evaluation)).open
    assert "No result" in page()


def test_values_that_are_no_numbers_are_no_numbers_on_the_page() -> None:
    evaluation = hand_evaluation(frames=50)
    series = {name: values.copy() for name, values in evaluation.series.items()}
    series["joint_error_mm"][10:20] = np.nan
    series["largest_joint_error_mm"][:] = np.inf
    points = evaluation.track.points
    assert points is not None
    points = points.copy()
    points[3] = np.nan
    track = dataclasses.replace(evaluation.track, points=points, cost=np.full(50, np.nan))
    text = page(dataclasses.replace(evaluation, series=series, track=track))
    result = data_of(text)["results"][0]
    assert "joint_error_mm" in result["quantities"]
    assert "largest_joint_error_mm" not in result["quantities"]
    assert "cost_mm" not in result["quantities"]


def test_a_head_is_shown_with_points_and_axes() -> None:
    result = data_of(page(head_evaluation(frames=40)))["results"][0]
    assert result["scene"]["pointCount"] == 10
    assert result["scene"]["axes"] is True
    groups = list(dict.fromkeys(one["group"] for one in result["components"]))
    assert groups[:2] == ["Head angles and expressions", "Head position"] and "Shape" in groups
    assert [one["label"] for one in result["scene"]["readings"]] == ["position error", "rotation error"]


def test_a_head_s_page_begins_with_angles_and_expressions() -> None:
    """In words with their ranges over the tracked frames, and as the first plots; a hand's with pictures."""
    whole = head_evaluation(frames=40)
    strengths = np.linspace(-0.25, 0.75, 40)
    numbers = np.stack([strengths, np.full(40, 0.1), np.full(40, 7.0)], axis=1)
    lost = np.arange(40) >= 20
    names = ("action_jaw_open", "action_jaw_open_sd", "score")
    track = dataclasses.replace(whole.track, numbers=numbers, number_names=names, lost=lost)
    text = page(dataclasses.replace(whole, track=track))
    assert (
        f"jaw open <strong>\u22120.25 to {strengths[19]:.2f}</strong>" in text
        and "score" not in text.split("<main")[0]
    )
    order = [text.index(f'<section id="{name}"') for name in ("trajectories", "worst", "summary")]
    assert order == sorted(order) and text.index("Roll <strong>") < text.index("Coverage <strong>")
    result = data_of(text)["results"][0]
    leading = [
        one["label"] for one in result["components"] if one["group"] == result["components"][0]["group"]
    ]
    assert leading == ["roll", "pitch", "yaw", "jaw open"]
    hand = page(hand_evaluation(frames=40))
    assert hand.index('<section id="worst"') < hand.index('<section id="trajectories"')
    assert "roll <strong>" not in hand.lower()


def test_a_long_result_is_reduced_and_the_page_says_so() -> None:
    frames = 10_000
    evaluation = hand_evaluation(frames=frames)
    peak = 6543
    series = {name: values.copy() for name, values in evaluation.series.items()}
    series["joint_error_mm"][peak] = 999.0
    text = page(dataclasses.replace(evaluation, series=series))
    result = data_of(text)["results"][0]
    line = result["quantities"]["joint_error_mm"]
    values = np.frombuffer(base64.b64decode(line["value"]["data"]), "<f4")
    assert values.max() == 999.0
    assert len(values) == line["points"] <= budget_for(1).quantity_points
    shown = np.frombuffer(base64.b64decode(result["scene"]["at"]["data"]), "<u4")
    numbers = np.frombuffer(base64.b64decode(result["kept"]["frames"]["data"]), "<u4")
    assert peak in numbers[shown]
    assert set(range(0, frames, result["scene"]["every"])) <= set(numbers[shown].tolist())
    words = re.sub(r"\s+", " ", Outline(text).words)
    assert f"up to {line['points']} of {frames} frames" in words
    assert f"3D view of {len(shown)} frames (1 in {result['scene']['every']}" in words
    assert len(text.encode()) < 10_000_000


def test_many_results_share_the_room() -> None:
    text = page(*(hand_evaluation(f"seed {i}", 300) for i in range(20)))
    assert len(text.encode()) < 10_000_000


def test_frame_numbers_are_those_of_the_recording() -> None:
    evaluation = hand_evaluation(frames=4)
    track = dataclasses.replace(evaluation.track, frame_index=np.array([100, 102, 104, 106]))
    kept = data_of(page(dataclasses.replace(evaluation, track=track)))["results"][0]["kept"]
    assert np.frombuffer(base64.b64decode(kept["frames"]["data"]), "<u4").tolist() == [100, 102, 104, 106]


def test_pictures_are_embedded_and_their_frames_are_in_the_scene() -> None:
    evaluation = hand_evaluation(frames=9_999)
    row = 7_777
    shown = dataclasses.replace(picture(), frame_index=row, stamp_ns=int(evaluation.track.stamp_ns[row]))
    text = page(evaluation, pictures={"a": [shown]})
    assert f"data:image/png;base64,{base64.b64encode(PNG).decode()}" in text
    result = data_of(text)["results"][0]
    at = np.frombuffer(base64.b64decode(result["scene"]["at"]["data"]), "<u4")
    assert row in np.frombuffer(base64.b64decode(result["kept"]["frames"]["data"]), "<u4")[at]


def test_pictures_beyond_the_room_are_left_out_and_the_page_says_how_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(gallery, "MOST_BYTES", 3 * len(PNG))
    given = {"a": [picture(i) for i in range(4)], "b": [picture(i) for i in range(2)]}
    text = page(hand_evaluation("a", 9), hand_evaluation("b", 9), pictures=given)
    assert text.count("data:image/png") == 3
    assert re.findall(r"Show frame (\d)", text) == ["0", "1", "0"]
    assert "3 more pictures were omitted" in text


def test_without_pictures_the_page_says_why() -> None:
    evaluation = hand_evaluation(frames=3)
    told = page(evaluation, pictures={"a": "there is no <recording>"})
    assert "No pictures: there is no <recording>." in Outline(told).words
    assert "No pictures were drawn." in page(evaluation)
    assert "No pictures: the result has no frames." in page(shortened(evaluation, 0))


def test_a_result_whose_pictures_find_no_room_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gallery, "MOST_BYTES", len(PNG))
    given = {"a": [picture()], "b": [picture()]}
    text = page(hand_evaluation("a", 9), hand_evaluation("b", 9), pictures=given)
    assert gallery.NO_ROOM in text and "1 more pictures" in text


@pytest.mark.parametrize("name", ["page.txt", "page", "folder.html"])
def test_a_name_that_no_page_can_have_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.html").mkdir()
    with pytest.raises(UsageError, match=r"not an HTML file name|output is a folder"):
        write_html(tmp_path / name, ReportPage([hand_evaluation(frames=2)], None, {}, "T"))


def test_a_page_in_a_folder_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="no folder"):
        write_html(tmp_path / "none" / "page.html", ReportPage([hand_evaluation(frames=2)], None, {}, "T"))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(ResultError, match="cannot be written"):
        write_html(tmp_path / "page.html", ReportPage([hand_evaluation(frames=2)], None, {}, "T"))


def test_a_page_that_fails_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "page.html"
    path.write_text("old")

    def full(part: Path, data: bytes) -> None:
        part.write_text("half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(packing, "write_output", full)
    with pytest.raises(ResultError, match="No space left"):
        write_html(path, ReportPage([hand_evaluation(frames=2)], None, {}, "T"))
    assert [one.name for one in tmp_path.iterdir()] == ["page.html"]
    assert path.read_text() == "old"


def test_every_script_is_on_the_page() -> None:
    folder = Path(gallery.__file__).parent / "scripts"
    text = page(hand_evaluation(frames=2))
    assert {path.stem for path in folder.glob("*.js")} == {*writer.SCRIPTS, *rows_page.SCRIPTS}
    for script in (folder / f"{name}.js" for name in writer.SCRIPTS):
        assert script.read_text(encoding="utf-8").strip() in text
