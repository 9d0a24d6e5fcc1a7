"""Write the HTML report: one self-contained page, whole or not at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from posetrack_cli.evaluation.html.components import Pictures, fitting, groups
from posetrack_cli.evaluation.html.packing import json_text, rendered, write_page
from posetrack_cli.evaluation.html.page_data import page_data
from posetrack_cli.evaluation.html.summary import (
    about,
    component_remark,
    decisive_rows,
    differences,
    folded_tables,
    honesty_remark,
    lead,
    meanings,
    notices,
    plot_remark,
    provenance,
    unmeasured,
)
from posetrack_cli.evaluation.judging.comparing import Comparison
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.measuring.pooling import Pool
from posetrack_cli.evaluation.measuring.subjects import KINDS

SCRIPTS = (
    "format",
    "data",
    "elements",
    "scale",
    "paths",
    "axes",
    "readout",
    "plot",
    "over_time",
    "curve",
    "honesty",
    "parts",
    "trajectories",
    "camera_view",
    "scene_data",
    "skeleton",
    "player",
    "main",
)
"""In the order in which the page runs them."""


@dataclass(frozen=True)
class ReportPage:
    """What a page shows.

    Attributes:
        evaluations: beside each other; their names are unique.
        comparison: paired differences of several results; None shows none.
        pictures: of each result, by its name, the worst frames first; or why there are none, as text.
        title: heading of the page.
        pools: the evaluations' frames together, where that says more than they do.
    """

    evaluations: Sequence[Evaluation]
    comparison: Comparison | None
    pictures: Pictures
    title: str
    pools: Sequence[Pool] = ()


def write_html(path: Path, page: ReportPage) -> None:
    """Write a page to ``*.html``; equal pages give equal bytes.

    The page loads nothing: styles, scripts, data and pictures are in it, and its security policy forbids
    connections. An existing page is replaced.

    Raises:
        UsageError: the path is not named as a page, or is a folder.
        ResultError: it cannot be written.
    """
    write_page(path, html_page(page))


def html_page(page: ReportPage) -> str:
    """Return the page's text, see ``write_html``."""
    from markupsafe import Markup

    evaluations = page.evaluations
    chosen = fitting(evaluations, page.pictures)
    data = page_data(evaluations, chosen.pictures, page.pools)
    return rendered(
        "report.html",
        page.title,
        SCRIPTS,
        names=[one.name for one in evaluations],
        lead=lead(evaluations),
        begins_with_angles=any(KINDS[one.subject].expressions for one in evaluations),
        notices=notices(evaluations),
        gallery={"groups": groups(evaluations, chosen), "dropped": chosen.dropped},
        key=decisive_rows(evaluations),
        comparison=differences(page.comparison),
        honesty_remark=honesty_remark(evaluations),
        plot_remark=plot_remark(data),
        component_remark=component_remark(data),
        tables=folded_tables(evaluations, page.pools),
        unmeasured=unmeasured(evaluations),
        meanings=meanings(evaluations),
        records=provenance(evaluations),
        about=about(data),
        data=Markup(json_text(data)),
    )
