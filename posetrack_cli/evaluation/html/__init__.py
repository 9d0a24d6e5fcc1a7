"""The HTML report: one self-contained page made from evaluations.

``writer`` puts it together; ``page_data`` reduces evaluations to what the page's plots show; ``summary`` and
``components`` return what its other parts say, as plain values. ``templates/*.html`` (Jinja2, which escapes
every value), ``report.css`` and ``scripts/*.js`` are the page itself, inlined when it is written
(``packing``). ``rows_page`` with ``rows.html`` is the page of many results: one table, a row for each.
"""

from posetrack_cli.evaluation.html.packing import check_page
from posetrack_cli.evaluation.html.rows_page import write_rows_html
from posetrack_cli.evaluation.html.writer import write_html

__all__ = ["check_page", "write_html", "write_rows_html"]
