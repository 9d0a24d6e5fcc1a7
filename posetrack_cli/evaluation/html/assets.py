"""What every page is made of and how it is written: texts beside this module, a security policy, one file."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable
from pathlib import Path
from string import Template

from posetrack_cli import __version__
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.html.components import text
from posetrack_cli.files import write_output
from posetrack_cli.outputs import check_place, whole_or_nothing

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


def filled(template: str, title: str, names: Iterable[str], **parts: str) -> str:
    """Return a page: a template with its head, style and scripts, and the parts that are its own.

    Args:
        template: file beside this module; its placeholders are those of all pages and of ``parts``.
        title: of the page, not escaped yet.
        names: of its scripts, in the order in which they run.
        parts: HTML, by placeholder.
    """
    style, script = asset("report.css"), scripts(names)
    shared = {"title": text(title), "version": text(__version__), "style": style, "script": script}
    head = Template(asset("head.html")).substitute(shared, policy=policy(style, script))
    return Template(asset(template)).substitute(shared, head=head, **parts)


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
