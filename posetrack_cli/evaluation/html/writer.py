"""Rendering of the HTML report as one self-contained page."""

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
"""Scripts in execution order."""


@dataclass(frozen=True)
class ReportPage:
    """Content of an HTML report.

    Attributes:
        evaluations: evaluations with unique names.
        comparison: paired differences; None for none.
        pictures: pictures by result name, worst first; or the reason why there are none.
        title: heading of the page.
        pools: pools of the evaluations.
    """

    evaluations: Sequence[Evaluation]
    comparison: Comparison | None
    pictures: Pictures
    title: str
    pools: Sequence[Pool] = ()


def write_html(path: Path, page: ReportPage) -> None:
    """Write an HTML report to ``*.html``; an existing one is overwritten.

    The page is self-contained and deterministic, and its content security policy forbids connections.

    Raises:
        UsageError: the name does not end with ``.html``, or is a folder.
        ResultError: the file cannot be written.
    """
    write_page(path, html_page(page))


def html_page(page: ReportPage) -> str:
    """Return the text of an HTML report; see ``write_html``."""
    # Jinja2 and markupsafe are only imported if a page is written.
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
        data=Markup(json_text(data)),  # json_text escapes everything that could end the script element
    )
