"""The HTML report: one self-contained page made from evaluations.

``writer`` puts it together; ``page_data`` reduces evaluations to what the page's plots show; ``summary``,
``provenance`` and ``gallery`` write the parts that need no script; ``report.html``, ``report.css`` and
``scripts/*.js`` are the page itself, inlined when it is written.
"""

from posetrack_cli.evaluation.html.writer import check_page, write_html

__all__ = ["check_page", "write_html"]
