"""What every page is made of and how it is written: templates, style, scripts, security policy, one file."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posetrack_cli.build import version
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.html.components import readable
from posetrack_cli.evaluation.html.summary import described
from posetrack_cli.evaluation.reports.table import ABSENT
from posetrack_cli.files import write_output
from posetrack_cli.outputs import check_place, whole_or_nothing

if TYPE_CHECKING:
    from jinja2 import Environment

HERE = Path(__file__).parent
ENDINGS = (".html", ".htm")


def check_page(path: Path) -> None:
    """Refuse a name that a page cannot have, before time is spent on what it shows.

    Raises:
        UsageError: it does not end in ``.html``, or is a folder.
        ResultError: its folder does not exist.
    """
    if path.suffix.lower() not in ENDINGS:
        raise UsageError("page is not named as HTML", where=path, expected="a name that ends in .html")
    if path.is_dir():
        raise UsageError("page is a folder", where=path, expected="the name of a file")
    check_place(path)


def write_page(path: Path, content: str) -> None:
    """Write a page to ``*.html``, whole or not at all; an existing one is replaced.

    Raises:
        UsageError: the path is not named as a page, or is a folder.
        ResultError: it cannot be written.
    """
    check_page(path)
    with whole_or_nothing(path) as part:
        write_output(part, content.encode("utf-8", "backslashreplace"))


def rendered(template: str, title: str, names: Iterable[str], /, **context: Any) -> str:
    """Return a page: a template with its head, style and scripts, and what it shows.

    Everything is escaped (Jinja2's autoescape) but style, scripts and what is ``Markup`` already.

    Args:
        template: file in ``templates``.
        title: of the page.
        names: of its scripts, in the order in which they run.
        context: what the template names.
    """
    from markupsafe import Markup

    style, script = asset("report.css"), scripts(names)
    shared = {"title": title, "version": version(), "policy": policy(style, script)}
    return (
        _environment()
        .get_template(template)
        .render(shared | context, style=Markup(style), script=Markup(script))
    )


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_finalised,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"minus": _minus, "readable": readable}
    environment.globals |= {"described": described, "absent": ABSENT}
    return environment


def _finalised(value: Any) -> Any:
    """Text in which control characters can be seen; what is HTML already stays."""
    return visible(value) if type(value) is str else value


def visible(value: str) -> str:
    """Return text in which what has no shape of its own, such as a control character, is a sign."""
    return "".join(c if c.isprintable() or c in "\n\u202f\u00a0" else "\ufffd" for c in value)


def _minus(value: object) -> str:
    """A number with the sign that is as wide as a plus."""
    return str(value).replace("-", "\u2212")


def scripts(names: Iterable[str]) -> str:
    """Return these scripts as one, in this order."""
    return '"use strict";\n' + "\n".join(asset(f"scripts/{name}.js") for name in names)


def asset(name: str) -> str:
    """Return the text of a file beside this module."""
    return (HERE / name).read_text(encoding="utf-8")


def policy(style: str, script: str) -> str:
    """Return a content security policy: the page's own script and style, embedded pictures, nothing else."""
    style_hash, script_hash = (
        base64.b64encode(hashlib.sha256(source.encode()).digest()).decode() for source in (style, script)
    )
    return (
        f"default-src 'none'; script-src 'sha256-{script_hash}'; style-src 'sha256-{style_hash}'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
