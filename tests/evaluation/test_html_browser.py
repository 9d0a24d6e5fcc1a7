"""The page in a real headless Chromium: it draws, moves, answers, fits, and asks nobody for anything."""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from posetrack_cli.evaluation.html import write_html, write_rows_html
from posetrack_cli.evaluation.html.packing import step_for
from posetrack_cli.evaluation.html.page_data import budget_for
from posetrack_cli.evaluation.html.rows_page import RowsPage
from posetrack_cli.evaluation.html.writer import ReportPage
from posetrack_cli.evaluation.judging.gates import check_gates, parse_gate
from posetrack_cli.evaluation.measuring.evaluation import Curve, Evaluation
from posetrack_cli.evaluation.reading.tracks import Coverage
from support.axe import serious_violations
from support.browser import console_lines, open_browser, requested, set_features, set_width
from support.evaluation import hand_evaluation
from support.html import NASTY, head_evaluation, picture, shortened, without_truth
from support.rows import result, result_set
from support.tracks import FRAME_NS

FRAMES = 120
PIXEL = 0.1
"""Coordinates are embedded in steps of 0.01 mm, and a millimetre takes less than ten pixels."""

PAUSE = """
const done = arguments[arguments.length - 1];
requestAnimationFrame(() => requestAnimationFrame(() => done()));
"""
PROJECTED = "return document.querySelector('.scene canvas').projected"


class Page:
    """A page in the browser."""

    def __init__(self, driver: Any, path: Path) -> None:
        self.driver = driver
        self.path = path

    def open(self, width: int = 1200, scheme: str = "light") -> Page:
        set_width(self.driver, width)
        set_features(self.driver, prefers_color_scheme=scheme)
        self.driver.get("about:blank")
        console_lines(self.driver), requested(self.driver)
        self.driver.get(self.path.as_uri())
        self.settle()
        return self

    def settle(self) -> None:
        """Wait until what was asked for is drawn."""
        self.driver.execute_async_script(PAUSE)

    def run(self, script: str, *arguments: Any) -> Any:
        result = self.driver.execute_script(script, *arguments)
        self.settle()
        return result

    def run_async(self, script: str, *arguments: Any) -> Any:
        """Run a script that calls its last argument when it is done."""
        return self.driver.execute_async_script(script, *arguments)

    def find(self, selector: str) -> Any:
        return self.driver.find_element("css selector", selector)

    def all(self, selector: str) -> list[Any]:
        found: list[Any] = self.driver.find_elements("css selector", selector)
        return found

    def choose(self, selector: str, value: str) -> None:
        """Choose an option of a select."""
        self.run(
            "const [one, value] = arguments; one.value = value; one.dispatchEvent(new Event('change'));",
            self.find(selector),
            value,
        )

    def slide(self, frame: int) -> None:
        self.run(
            "const [one, value] = arguments; one.value = value; one.dispatchEvent(new Event('input'));",
            self.find(".scene input[type=range]"),
            frame,
        )

    def joints(self, which: str = "estimate") -> np.ndarray:
        """(D, 3) where the drawn points are: pixels, and mm away from the centre."""
        return np.array(self.run(PROJECTED)[which], dtype=np.float64)

    def path_of(self, selector: str) -> str:
        return str(self.find(selector).get_attribute("d"))

    def mouse(self, kind: str, selector: str, share: float, **more: Any) -> None:
        """A mouse event at a share of the width of an element, half way down."""
        found = self.find(selector)
        self.run("arguments[0].scrollIntoView({block: 'center'})", found)
        box = self.run("return arguments[0].getBoundingClientRect().toJSON()", found)
        values = {"x": box["x"] + share * box["width"], "y": box["y"] + 0.5 * box["height"], **more}
        self.driver.execute_cdp_cmd("Input.dispatchMouseEvent", {"type": kind, **values})
        self.settle()

    def click(self, selector: str, share: float) -> None:
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            button = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
            self.mouse(kind, selector, share, **button)

    def press(self, selector: str, *keys: str) -> None:
        self.find(selector).send_keys(*keys)
        self.settle()

    @property
    def reading(self) -> list[str]:
        """Frame, time, status, errors."""
        return [one.text for one in self.all(".scene .reading span")]

    def picture(self) -> np.ndarray:
        """What the viewport shows."""
        data = base64.b64decode(self.driver.get_screenshot_as_base64())
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        return image

    def canvas_colours(self) -> int:
        """How many different colours the 3-D view has."""
        return int(
            self.run(
                "const c = document.querySelector('.scene canvas');"
                "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
                "return new Set(new Uint32Array(d.buffer)).size;"
            )
        )


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    with open_browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


Make = Callable[..., Page]


@pytest.fixture
def make(driver: Any, tmp_path: Path) -> Make:
    """Writes a page about evaluations and opens it."""

    def made(*evaluations: Evaluation, width: int = 1200, scheme: str = "light", **pictures: Any) -> Page:
        path = tmp_path / "page.html"
        write_html(path, ReportPage(evaluations, None, pictures, "A page"))
        return Page(driver, path).open(width, scheme)

    return made


def some_lost(evaluation: Evaluation) -> Evaluation:
    """Frames 30 to 39 are lost, frames 60 to 69 do not exist."""
    lost = np.arange(FRAMES) % FRAMES // 10 == 3
    stamps = evaluation.track.stamp_ns + np.where(np.arange(FRAMES) >= 60, 10 * FRAME_NS, 0)
    track = dataclasses.replace(evaluation.track, lost=lost, stamp_ns=stamps)
    return dataclasses.replace(evaluation, track=track, series_stamp_ns=stamps)


def test_a_page_is_silent_and_asks_for_nothing(make: Make) -> None:
    page = make(some_lost(hand_evaluation(frames=FRAMES)), a=[picture()])
    assert console_lines(page.driver) == []
    asked = [address for address in requested(page.driver) if not address.startswith("data:")]
    assert asked == [page.path.as_uri()]
    assert page.run("return performance.getEntriesByType('resource').length") == 0
    assert not page.all("link[href]:not([href^='data:'])")


def test_connections_are_refused(make: Make) -> None:
    page = make(hand_evaluation(frames=5))
    refused = page.run_async(
        "const done = arguments[0]; fetch('data:text/plain,x').then(() => done(false), () => done(true));"
    )
    assert refused
    assert any("Content Security Policy" in line for line in console_lines(page.driver))


def test_plots_are_drawn(make: Make) -> None:
    page = make(some_lost(hand_evaluation(frames=FRAMES)))
    for section in ("#over-time-plot", "#curve-plot", "#trajectory-plots"):
        path = page.path_of(f"{section} path.line:not(.thin):not(.truth)")
        numbers = np.array(path.replace("M", " ").replace("L", " ").split(), dtype=np.float64)
        x, y = numbers[::2], numbers[1::2]
        assert len(x) > 100
        assert np.all(np.diff(x) >= 0)
        assert np.ptp(x) > 200 and np.ptp(y) > 20
        assert len(page.all(f"{section} text")) > 6
    assert len(page.all("#trajectory-plots path.band")) == 3
    assert len(page.all("#parts-plot line.bar")) == 1  # the made-up evaluation has one joint of its own
    assert len(page.all("#over-time-plot .plot rect.lost")) == 1
    assert page.path_of("#over-time-plot path.line").count("M") == 2, (
        "the line breaks where frames are missing"
    )
    assert page.canvas_colours() > 10


def test_the_line_is_where_its_values_are(make: Make) -> None:
    evaluation = hand_evaluation(frames=FRAMES)
    page = make(evaluation)
    path = page.path_of("#over-time-plot path.line:not(.thin)")
    y = np.array(path[1:].replace("L", " ").split(), dtype=np.float64)[1::2]
    values = evaluation.series["joint_error_mm"]
    slope, offset = np.polyfit(values, y, 1)
    assert slope < 0
    np.testing.assert_allclose(slope * values + offset, y, atol=0.1)  # coordinates have one decimal


def test_confidence_has_its_diagram_and_its_curve(make: Make) -> None:
    evaluation = hand_evaluation(frames=FRAMES)
    judged = evaluation.judged
    assert judged is not None
    page = make(evaluation)
    spots = page.all("#reliability-plot circle.spot")
    at = np.array([[float(str(one.get_attribute(key))) for key in ("cx", "cy", "r")] for one in spots])
    assert len(at) == 2 and at[1, 2] > at[0, 2]  # 30 frames say 0.65, 90 say 0.85
    (diagonal,) = page.all("#reliability-plot line.diagonal")
    x1, y1, x2, y2 = (float(str(diagonal.get_attribute(key))) for key in ("x1", "y1", "x2", "y2"))
    confidence, right = (at[:, 0] - x1) / (x2 - x1), (at[:, 1] - y1) / (y2 - y1)
    expected = [judged.right[judged.confidence == stated].mean() for stated in (0.65, 0.85)]
    np.testing.assert_allclose(confidence, [0.65, 0.85], atol=1e-3)
    np.testing.assert_allclose(right, expected, atol=1e-3)
    assert page.path_of("#roc-plot path.line").count("L") == 2  # from nothing over two confidences to all
    page.press("#roc-plot .plot", "\ue010")  # end
    assert "confidence \u2265 0.650" in page.find("#roc-plot .tip").text


def test_a_curve_that_rises_upright_can_be_walked_along(make: Make) -> None:
    evaluation = hand_evaluation(frames=4)
    assert evaluation.judged is not None
    confidence, right = np.array([0.9, 0.8, 0.7, 0.6]), np.array([True, True, True, False])
    page = make(
        dataclasses.replace(
            evaluation, judged=dataclasses.replace(evaluation.judged, confidence=confidence, right=right)
        )
    )
    page.press("#roc-plot .plot", "\ue014", "\ue014")  # two arrows to the right: from no wrong frame to all
    assert page.find("#roc-plot .tip").text.startswith("100.0 %")
    page.press("#roc-plot .plot", "\ue012")  # and one back
    assert page.find("#roc-plot .tip").text.startswith("0.000 %")


def test_what_cannot_be_judged_is_said_in_place_of_its_plot(make: Make) -> None:
    page = make(without_truth(hand_evaluation(frames=5)))
    assert "No ground truth" in page.find("#reliability-plot .missing").text
    evaluation = hand_evaluation(frames=5)
    assert evaluation.judged is not None
    right = dataclasses.replace(evaluation.judged, right=np.ones(5, dtype=np.bool_))
    page = make(dataclasses.replace(evaluation, judged=right))
    assert page.all("#reliability-plot circle.spot")
    assert "All frames are correct" in page.find("#roc-plot .missing").text


def test_the_slider_moves_the_hand_as_projected(make: Make) -> None:
    evaluation = hand_evaluation(frames=FRAMES)
    page = make(evaluation)
    points, truth = evaluation.track.points, evaluation.truth
    assert points is not None and truth is not None and truth.points is not None
    first = page.joints()
    canvas = page.find(".scene canvas")
    size = page.run("return [arguments[0].clientWidth, arguments[0].clientHeight]", canvas)
    scale = None
    for frame in (0, 17, FRAMES - 1):
        page.slide(frame)
        centre = truth.points[frame].mean(axis=0)
        for which, expected in (("estimate", points[frame]), ("truth", truth.points[frame])):
            seen = page.joints(which)
            moved = expected - centre
            flat = seen[:, :2] - np.array(size) / 2
            scale = scale or float((flat * moved[:, :2]).sum() / (moved[:, :2] ** 2).sum())
            np.testing.assert_allclose(flat, scale * moved[:, :2], atol=PIXEL)
            np.testing.assert_allclose(seen[:, 2], moved[:, 2], atol=PIXEL)
        assert page.reading[:3] == [f"frame {frame}", f"{frame * FRAME_NS / 1e9:.3f} s", "tracking"]
    assert np.abs(page.joints() - first).max() > 5


def test_drag_turns_wheel_zooms_reset_restores(make: Make) -> None:
    page = make(hand_evaluation(frames=FRAMES))
    before = page.joints()
    page.mouse("mousePressed", ".scene canvas", 0.5, button="left", clickCount=1)
    page.mouse("mouseMoved", ".scene canvas", 0.7, button="left", buttons=1)
    page.mouse("mouseReleased", ".scene canvas", 0.7, button="left", clickCount=1)
    turned = page.joints()
    assert np.abs(turned[:, 0] - before[:, 0]).max() > 10, "a turn about the vertical moves points sideways"
    np.testing.assert_allclose(turned[:, 1], before[:, 1], atol=1e-6)
    page.mouse("mouseWheel", ".scene canvas", 0.5, deltaX=0, deltaY=-100)
    zoomed = page.joints()
    assert np.ptp(zoomed[:, 1]) > 1.05 * np.ptp(turned[:, 1])
    page.find(".scene button[aria-label='Reset view']").click()
    np.testing.assert_allclose(page.joints(), before)


def test_keys_step_jump_turn_and_play(make: Make) -> None:
    page = make(hand_evaluation(frames=FRAMES))
    canvas = ".scene canvas"
    page.press(canvas, "\ue014", "\ue014")  # right, twice
    assert page.reading[0] == "frame 2"
    page.press(canvas, "\ue012")  # left
    assert page.reading[0] == "frame 1"
    page.press(canvas, "\ue010")  # end
    assert page.reading[0] == f"frame {FRAMES - 1}"
    before = page.joints()
    page.press(canvas, "\ue008\ue014\ue000")  # shift and right
    assert np.abs(page.joints() - before).max() > 1
    page.press(canvas, "0", "\ue011")  # reset, home
    assert page.reading[0] == "frame 0"
    page.choose(".scene select", "0.25")  # 16 s for all frames: it will not end meanwhile
    page.press(canvas, " ")
    page.run_async(
        "const [slider, done] = arguments;"
        "const wait = () => (Number(slider.value) > 3 ? done() : requestAnimationFrame(wait)); wait();",
        page.find(".scene input[type=range]"),
    )
    page.press(canvas, " ")
    shown = page.reading
    page.run_async("setTimeout(arguments[0], 150)")
    assert page.reading == shown, "it pauses"


def test_nothing_plays_by_itself(make: Make) -> None:
    page = make(hand_evaluation(frames=FRAMES))
    page.run_async("setTimeout(arguments[0], 200)")
    assert page.find(".scene input[type=range]").get_attribute("value") == "0"


def test_hovering_reads_time_frame_and_value_of_that_frame(make: Make) -> None:
    evaluation = hand_evaluation(frames=FRAMES)
    page = make(evaluation)
    page.mouse("mouseMoved", "#over-time-plot .plot svg", 0.5)
    frame = int(page.find("#over-time-plot .tip .unit").text.removeprefix("frame "))
    assert 40 < frame < 80
    assert page.find("#over-time-plot .tip div").text.startswith(f"{frame * FRAME_NS / 1e9:.3f} s")
    value, unit = page.find("#over-time-plot .tip b").text.split()
    assert unit == "mm"
    shown = 0.5e-2 if float(value) >= 10 else 0.5e-3  # places of the read-out
    assert float(value) == pytest.approx(evaluation.series["joint_error_mm"][frame], abs=1.01 * shown)
    inside = "const [tip] = arguments; return tip.scrollWidth <= tip.clientWidth && tip.clientWidth < 400"
    assert page.run(inside, page.find("#over-time-plot .tip"))
    page.mouse("mouseMoved", "h1", 0.5)
    assert not page.find("#over-time-plot .tip").is_displayed()


def test_the_cursor_moves_by_keys(make: Make) -> None:
    page = make(hand_evaluation(frames=FRAMES))
    page.press("#over-time-plot .plot", "\ue011", "\ue014", "\ue014")  # home, right, right
    assert page.find("#over-time-plot .tip .unit").text == "frame 2"
    page.press("#over-time-plot .plot", "\ue007")  # enter
    assert page.reading[0] == "frame 2"


def test_a_click_in_the_plot_shows_that_frame(make: Make) -> None:
    page = make(hand_evaluation(frames=FRAMES))
    page.click("#over-time-plot .plot svg", 0.75)
    assert page.find("#over-time-plot .tip .unit").text == page.reading[0] != "frame 0"
    assert page.find("#trajectory-plots .now").get_attribute("visibility") == "visible"


def test_a_worst_frame_leads_to_its_place(make: Make) -> None:
    page = make(hand_evaluation(frames=FRAMES), a=[picture(77, 77 * FRAME_NS)])
    page.run("arguments[0].click()", page.find(".jump"))
    assert page.reading[0] == "frame 77"


def test_dragging_shows_a_shorter_time_everywhere_and_a_button_the_whole(make: Make) -> None:
    page = make(hand_evaluation(frames=FRAMES))
    before = page.path_of("#over-time-plot path.line"), page.path_of("#trajectory-plots path.line")
    page.mouse("mousePressed", "#over-time-plot .plot svg", 0.4, button="left", clickCount=1)
    page.mouse("mouseMoved", "#over-time-plot .plot svg", 0.6, button="left", buttons=1)
    page.mouse("mouseReleased", "#over-time-plot .plot svg", 0.6, button="left", clickCount=1)
    after = page.path_of("#over-time-plot path.line"), page.path_of("#trajectory-plots path.line")
    assert all(new.count("L") < 0.4 * old.count("L") for new, old in zip(after, before, strict=True))
    page.find("#over-time-plot .reset").click()
    page.settle()
    assert page.path_of("#over-time-plot path.line") == before[0]


def test_components_can_be_chosen(make: Make) -> None:
    page = make(hand_evaluation(frames=FRAMES))
    page.choose("#component-choice", "Index angles")
    titles = [one.text for one in page.all("#trajectory-plots .axis-title")]
    assert "pip flexion, deg" in titles
    page.choose("#component-choice", "Wrist rotation, quaternion")
    assert len(page.all("#trajectory-plots .plot")) == 4


def test_quantities_can_be_chosen(make: Make) -> None:
    page = make(hand_evaluation(frames=FRAMES))
    assert len(page.all("#over-time-plot path.line")) == 2
    page.choose("#quantity-choice", "ess")
    assert len(page.all("#over-time-plot path.line")) == 1


def test_the_curve_is_of_the_largest_or_of_the_mean_error(make: Make) -> None:
    curve = Curve(np.array([0.0, 50.0, 100.0]), np.array([0.0, 0.2, 1.0]), np.array([0.0, 0.8, 1.0]))
    page = make(hand_evaluation(frames=FRAMES, curve=curve))
    largest = page.path_of("#curve-plot path.line")
    page.choose("#curve-choice", "meanShare")
    assert page.path_of("#curve-plot path.line") != largest
    page.choose("#curve-choice", "share")
    assert page.path_of("#curve-plot path.line") == largest


def test_several_results_are_overlaid_and_one_is_shown_in_detail(make: Make) -> None:
    evaluations = [some_lost(hand_evaluation(name, FRAMES, 3.0 + i)) for i, name in enumerate("ab")]
    page = make(*evaluations, b=[picture()])
    assert len(page.all("#over-time-plot path.line")) == 4
    assert len(page.all("#over-time-plot .plot rect.lost")) == 2
    assert len(page.all("#curve-plot path.line")) == 2
    first, shown = page.joints(), page.path_of("#trajectory-plots path.line:not(.truth)")
    assert not page.find("#worst figure").is_displayed()
    page.choose("#result-choice", "1")
    assert np.abs(page.joints() - first).max() > 0.5
    assert page.path_of("#trajectory-plots path.line:not(.truth)") != shown
    assert page.find("#worst figure").is_displayed()
    page.run("arguments[0].click()", page.find("#over-time-plot input[type=checkbox]"))
    assert len(page.all("#over-time-plot path.line")) == 2
    assert console_lines(page.driver) == []


def test_dark_and_light_differ_and_text_can_be_read_in_both(make: Make) -> None:
    page = make(hand_evaluation(frames=FRAMES))
    light = page.picture()
    colours = page.canvas_colours()
    page.open(scheme="dark")
    dark = page.picture()
    assert light.mean() > 200 > 80 > dark.mean()
    assert colours > 10 < page.canvas_colours()


CONTRAST = """
const luminance = (colour) => {
  const [r, g, b] = colour.match(/[\\d.]+/g).map(Number).slice(0, 3).map((v) => v / 255)
    .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const probe = document.body.appendChild(document.createElement('span'));
const shown = (name) => {
  probe.style.color = `var(${name})`;
  return luminance(getComputedStyle(probe).color);
};
return Object.fromEntries(arguments[0].map(([ink, paper]) => {
  const [a, b] = [shown(ink), shown(paper)].sort((x, y) => y - x);
  return [`${ink} on ${paper}`, (a + 0.05) / (b + 0.05)];
}));
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_contrast_is_enough(make: Make, scheme: str) -> None:
    """WCAG 2.1: 4.5 for text, 3 for what is drawn."""
    page = make(hand_evaluation(frames=5), scheme=scheme)
    text = [[ink, paper] for ink in ("--ink", "--soft") for paper in ("--paper", "--panel")]
    drawn = [[f"--c{i}", "--panel"] for i in range(6)] + [["--truth", "--panel"], ["--focus", "--paper"]]
    found = page.run(CONTRAST, [*text, ["--ink", "--warn"], *drawn])
    assert all(found[f"{ink} on {paper}"] >= 4.5 for ink, paper in [*text, ["--ink", "--warn"]]), found
    assert all(found[f"{ink} on {paper}"] >= 3.0 for ink, paper in drawn), found


UNFOLD = "document.querySelectorAll('details').forEach((one) => { one.open = true; })"
PHONE_PX = 390


def test_no_table_is_cut_on_a_phone_and_every_cell_names_its_column(make: Make) -> None:
    """Figures of one result and of several, run records; also those that were folded."""
    for evaluations in (
        [head_evaluation(frames=30)],
        [hand_evaluation(f"take {i}", 60, 3.0 + i) for i in range(5)],
    ):
        page = make(*evaluations, width=PHONE_PX)
        page.run(UNFOLD)
        cut = page.run(
            "return [...document.querySelectorAll('.scrolling, .contents, .key, figure')].filter((one) =>"
            " one.scrollWidth > one.clientWidth + 1).map((one) => one.outerHTML.slice(0, 120))"
        )
        assert cut == []
        outside = page.run(
            "return [...document.querySelectorAll('td, th, a')].filter((one) => one.offsetWidth > 1 &&"
            " one.getBoundingClientRect().right > innerWidth).length"
        )
        assert outside == 0
        nameless = "td:not(:first-child):not([data-label])"
        assert page.all(f"table.figures tbody {nameless}") == []
        shown = page.run(
            "const cell = document.querySelector('table.figures tbody td');"
            "return getComputedStyle(cell, '::before').content"
        )
        assert shown.strip('"').strip() in {"mean/value", *(one.name for one in evaluations)}


@pytest.mark.parametrize(("width", "scheme"), [(PHONE_PX, "dark"), (1200, "light")])
def test_axe_finds_nothing_serious(make: Make, width: int, scheme: str) -> None:
    """With everything unfolded: several results with pictures; one of little, without truth."""
    several = [some_lost(hand_evaluation(name, FRAMES, 3.0 + i)) for i, name in enumerate("ab")]
    shown = several if width == PHONE_PX else [without_truth(head_evaluation(frames=20))]
    page = make(*shown, width=width, scheme=scheme, a=[picture()])
    page.run(UNFOLD)
    assert serious_violations(page.driver) == []


def test_axe_finds_nothing_serious_on_a_page_of_many_results(driver: Any, tmp_path: Path) -> None:
    members = [result(f"take-{place}", 2.0 + place) for place in range(8)]
    outcomes = check_gates([parse_gate("joint_error_mm.mean > 5")], members)
    links = {"take-1": "./x.html"}
    found = RowsPage([result_set(members, outcomes)], outcomes, missing=[("a", "b")], links=links)
    write_rows_html(tmp_path / "rows.html", found)
    page = Page(driver, tmp_path / "rows.html").open(PHONE_PX)
    page.run(UNFOLD)
    assert serious_violations(driver) == []
    assert page.run("return document.documentElement.scrollWidth") == PHONE_PX


def test_axe_would_find_what_is_wrong(make: Make) -> None:
    page = make(hand_evaluation(frames=5), a=[picture()])
    page.run("document.querySelector('figure img').removeAttribute('alt')")
    page.run("document.querySelector('h1').style.color = '#ddd'")
    found = serious_violations(page.driver)
    assert any("image-alt" in one for one in found) and any("color-contrast" in one for one in found)


def test_pictures_and_the_view_in_space_come_first_and_the_contents_lead_to_all(make: Make) -> None:
    page = make(hand_evaluation(frames=FRAMES), a=[picture()])
    places = page.run("return [...document.querySelectorAll('main section')].map((one) => one.id)")
    assert places[:3] == ["worst", "scene", "summary"] and places.index("tables") > places.index("over-time")
    links = page.run(
        "return [...document.querySelectorAll('.contents a')].map((a) => a.getAttribute('href'))"
    )
    assert {link.removeprefix("#") for link in links} <= set(places)
    page.find(".contents a[href='#tables']").click()
    page.settle()
    bar, heading = (page.find(one).rect for one in (".contents", "#tables h2"))
    top = page.run("return scrollY")
    assert bar["y"] + bar["height"] <= heading["y"] + 1 and heading["y"] - top < 900, (
        "the bar hides no heading"
    )


def test_who_wants_less_motion_is_not_scrolled_smoothly(make: Make) -> None:
    page = make(hand_evaluation(frames=FRAMES), a=[picture(77, 77 * FRAME_NS)])
    told = "window.told = []; Element.prototype.scrollIntoView = function (how) { told.push(how.behavior); }"
    page.run(told)
    for motion in ("reduce", "no-preference"):
        set_features(page.driver, prefers_reduced_motion=motion)
        page.run("arguments[0].click()", page.find(".jump"))
    assert page.run("return told") == ["auto", "smooth"]


@pytest.mark.parametrize("width", [360, 800, 1600])
def test_the_page_does_not_scroll_sideways(make: Make, width: int) -> None:
    run = {"input.name": "a-very-long-name-" * 10, "configuration": '{"a": {"b": "' + "x" * 300 + '"}}'}
    evaluation = dataclasses.replace(some_lost(hand_evaluation("n" * 90, FRAMES)), run=run)
    page = make(evaluation, hand_evaluation("b", FRAMES), width=width)
    page.run("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    wide = page.run(
        "return [...document.querySelectorAll('body *')].filter((one) =>"
        " !one.closest('.scrolling, svg, .skip') && one.getBoundingClientRect().right > innerWidth + 1)"
        ".map((one) => one.outerHTML.slice(0, 80))"
    )
    assert wide == []
    assert page.run("return document.documentElement.scrollWidth") == width


def test_controls_have_names_and_can_be_reached(make: Make) -> None:
    page = make(hand_evaluation("a", FRAMES), hand_evaluation("b", FRAMES), a=[picture()])
    nameless = page.run(
        "const all = 'button, select, input, canvas, svg:not([aria-hidden]), img';"
        "const named = (one) => one.getAttribute('aria-label') || one.textContent.trim() || one.alt;"
        "const nameless = (one) => !named(one) && !one.labels?.length;"
        "return [...document.querySelectorAll(all)].filter(nameless).map((one) => one.outerHTML.slice(0, 90))"
    )
    assert nameless == []
    page.run("document.querySelector('.scene canvas').focus()")
    assert page.run("return document.activeElement.tagName") == "CANVAS"


def test_names_of_users_run_nothing(make: Make) -> None:
    nasty = dataclasses.replace(hand_evaluation(frames=20), name=NASTY, run={NASTY: NASTY}, notes=(NASTY,))
    other = dataclasses.replace(hand_evaluation("b", 20), name="<img src=x onerror=alert(2)>")
    page = make(nasty, other)
    assert console_lines(page.driver) == []
    assert not page.all("img")
    assert page.find("#result-choice option").get_attribute("textContent") == NASTY
    page.mouse("mouseMoved", "#over-time-plot .plot svg", 0.5)
    assert "<img src=x onerror=alert(2)>" in page.find("#over-time-plot .tip").text


def lost_everywhere(evaluation: Evaluation) -> Evaluation:
    frames = len(evaluation.track)
    return dataclasses.replace(
        evaluation,
        coverage=Coverage(frames, 0, frames, 0, 0, 0, 0, True, 0),
        track=dataclasses.replace(evaluation.track, lost=np.ones(frames, dtype=np.bool_)),
    )


@pytest.mark.parametrize(
    ("evaluation", "said"),
    [
        (shortened(hand_evaluation(frames=9), 1), "frame 0"),
        (dataclasses.replace(without_truth(shortened(hand_evaluation(frames=9), 0))), "No frames"),
        (without_truth(hand_evaluation(frames=30)), "No ground truth with joints"),
        (lost_everywhere(hand_evaluation(frames=30)), "lost"),
        (head_evaluation(frames=30), "position error, mm"),
    ],
    ids=["one frame", "empty", "no truth", "lost everywhere", "head"],
)
def test_pages_of_little_say_what_is_missing(make: Make, evaluation: Evaluation, said: str) -> None:
    page = make(evaluation)
    assert console_lines(page.driver) == []
    assert said in page.find("main").text


def test_a_page_without_results_is_silent(make: Make) -> None:
    page = make()
    assert console_lines(page.driver) == []
    assert "No results" in page.find("main").text


def test_a_head_s_points_and_axes_move(make: Make) -> None:
    evaluation = head_evaluation(frames=60)
    page = make(evaluation)
    before = page.joints()
    assert before.shape == (14, 3)  # ten points, the origin, three ends
    page.slide(40)
    assert np.abs(page.joints() - before).max() > 5


def test_printed_it_is_light_and_everything_is_unfolded(make: Make) -> None:
    page = make(hand_evaluation(frames=FRAMES), scheme="dark")
    page.run("window.dispatchEvent(new Event('beforeprint'))")
    assert page.run("return [...document.querySelectorAll('details')].every((one) => one.open)")
    assert page.picture().mean() > 200
    page.run("window.dispatchEvent(new Event('afterprint'))")
    assert page.picture().mean() < 80
    assert not page.run("return [...document.querySelectorAll('details')].some((one) => one.open)")


def test_ten_thousand_frames_are_drawn(make: Make) -> None:
    page = make(hand_evaluation(frames=10_000))
    assert console_lines(page.driver) == []
    page.slide(1)
    assert page.reading[0] == f"frame {step_for(10_000, budget_for(1).scene_frames)}"
    assert page.canvas_colours() > 10


def test_rows_are_sorted_and_filtered(driver: Any, tmp_path: Path) -> None:
    members = [result(f"take-{place}", error) for place, error in ((2, 3.0), (10, 9.0), (1, 6.0))]
    blind = result("blind", 1.0, metrics={"coverage": 1.0, "frames": 4.0}, absent={"joint_error_mm": "no"})
    members.append(blind)
    outcomes = check_gates([parse_gate("joint_error_mm.mean > 5")], members)
    path = tmp_path / "rows.html"
    write_rows_html(path, RowsPage([result_set(members, outcomes)], outcomes))
    page = Page(driver, path).open()
    cells = "document.querySelectorAll('table.rows tbody tr:not([hidden]) th')"
    names = f"return [...{cells}].map((cell) => cell.textContent)"
    assert page.run(names) == ["blind", "take-10", "take-1", "take-2"]
    heads = page.all("table.rows thead th button")
    error = next(one for one in heads if one.text.startswith("joint error, mean"))
    error.click()  # was in order of it, the largest first
    assert page.run(names) == ["take-2", "take-1", "take-10", "blind"]
    error.click()
    assert page.run(names) == ["take-10", "take-1", "take-2", "blind"]
    heads[0].click()
    assert page.run(names) == ["blind", "take-1", "take-2", "take-10"]  # numbers within names count
    assert [one.get_attribute("aria-sort") for one in page.all("table.rows th[aria-sort]")] == ["ascending"]
    page.press(".name-filter", "TAKE-1")
    assert page.run(names) == ["take-1", "take-10"]
    assert page.find(".shown-count").text == "2 of 4 results shown"
    page.find(".only-failed").click()
    page.press(".name-filter", "0")
    assert page.run(names) == ["take-10"]
    page.run("document.querySelector('.name-filter').value = ''")
    page.run("document.querySelector('.name-filter').dispatchEvent(new Event('input'))")
    assert page.run(names) == ["blind", "take-1", "take-10"]  # what cannot be judged has failed
    assert console_lines(page.driver) == []
    asked = [address for address in requested(page.driver) if not address.startswith("data:")]
    assert asked == [path.as_uri()]
