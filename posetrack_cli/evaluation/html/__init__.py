"""HTML reports: a self-contained page of evaluations, and a page with one table row per result.

``writer`` renders the page. ``page_data`` reduces evaluations to the data of the plots. ``summary`` and
``components`` return the content of the other sections as plain values. ``packing`` inlines
``templates/*.html`` (Jinja2 with autoescaping), ``report.css`` and ``scripts/*.js``. ``rows_page`` renders
``rows.html``, the page of many results.
"""

from posetrack_cli.evaluation.html.packing import check_page
from posetrack_cli.evaluation.html.rows_page import write_rows_html
from posetrack_cli.evaluation.html.writer import write_html

__all__ = ["check_page", "write_html", "write_rows_html"]
