"""The documentation builds without a warning, and its pages ask nobody else for anything."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from support.axe import serious_violations
from support.browser import open_browser, set_width
from support.markdown import ROOT, without_blocks

LONGEST_README = 150
_LINK = re.compile(r"(?<!!)\[[^\]]*\]\(([^)\s]+)\)|!\[[^\]]*\]\(([^)\s]+)\)")
_LOADED = re.compile(r"<(?:script|img|iframe|link)\b[^>]*\b(?:src|href)=[\"']?((?:https?:)?//[^\"'\s>]+)")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder],
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    assert "WARNING" not in built.stderr
    return folder


def test_every_page_is_built_and_in_the_navigation(site: Path) -> None:
    start = (site / "index.html").read_text(encoding="utf-8")
    for page in (ROOT / "docs").rglob("*.md"):
        name = page.relative_to(ROOT / "docs").with_suffix(".html").as_posix()
        assert (site / name).is_file()
        assert f'href="{name}"' in start or name == "index.html"


def test_included_pages_are_whole(site: Path) -> None:
    security = (site / "security.html").read_text(encoding="utf-8")
    assert "CHUNK_BYTES" in security and "--8&lt;--" not in security


def test_no_page_loads_anything_from_elsewhere(site: Path) -> None:
    for page in site.rglob("*.html"):
        assert _LOADED.findall(page.read_text(encoding="utf-8")) == []


def test_tables_and_lists_are_drawn_as_such(site: Path) -> None:
    """Python's Markdown wants an empty line before a list, GitHub's does not."""
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        for paragraph in re.findall(r"<p>(.*?)</p>", text, re.DOTALL):
            assert not re.search(r"\n(?:- |\d+\. |\|)", paragraph), f"{page.name}: {paragraph[:200]}"


SCHEME = """
const style = document.head.appendChild(document.createElement("style"));
style.textContent = "* { transition: none !important; }";
document.body.setAttribute("data-md-color-scheme", arguments[0]);
"""


def test_axe_finds_nothing_serious(site: Path, tmp_path: Path) -> None:
    """On a telephone in light colours, wide in dark ones: text, code, tables, pictures, the theme around."""
    with open_browser(tmp_path) as driver:
        for name, width, scheme in (("index", 390, "default"), ("results", 1200, "slate")):
            set_width(driver, width)
            driver.get((site / f"{name}.html").as_uri())
            driver.execute_script(SCHEME, scheme)
            assert serious_violations(driver) == [], name
            assert driver.execute_script("return document.documentElement.scrollWidth") == width


def slug(heading: str) -> str:
    """The anchor that GitHub gives a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "SECURITY.md"])
def test_links_lead_somewhere(name: str) -> None:
    for found in _LINK.findall(without_blocks(ROOT / name)):
        target, _, anchor = "".join(found).partition("#")
        page = ROOT / target
        assert page.is_file(), f"{name}: {target}"
        if anchor:
            headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in map(slug, headings), f"{name}: {target}#{anchor}"


def test_readme_stays_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= LONGEST_README
