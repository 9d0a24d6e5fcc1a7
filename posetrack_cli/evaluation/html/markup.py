"""Text as HTML: whatever a user, a file or a run says is escaped here."""

from __future__ import annotations

import html
from collections.abc import Iterable


def readable(name: str) -> str:
    """Return a name with spaces."""
    return name.replace("_", " ")


def text(value: object) -> str:
    """Return text that stands for itself in an element or a quoted attribute; controls become visible."""
    shown = "".join(c if c.isprintable() or c in "\n\u202f\u00a0" else "\ufffd" for c in str(value))
    return html.escape(shown, quote=True)


def element(name: str, content: str, **attributes: object) -> str:
    """Return an element with content that is HTML already; ``class_`` is the attribute class."""
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{text(value)}"' for key, value in attributes.items()
    )
    return f"<{name}{written}>{content}</{name}>"


def row(cells: Iterable[str], **attributes: object) -> str:
    """Return a table row of cells that are elements already."""
    return element("tr", "".join(cells), **attributes)


def listed(items: Iterable[str]) -> str:
    """Return a list of items that are HTML already, or nothing if there are none."""
    made = "".join(element("li", item) for item in items)
    return element("ul", made) if made else ""


def details(summary: str, content: str, **attributes: object) -> str:
    """Return content that is shown on demand."""
    return element("details", element("summary", text(summary)) + content, **attributes)


def scrolling(content: str, label: str) -> str:
    """Return content that scrolls sideways by itself where it is too wide, also by keyboard."""
    return element("div", content, class_="scrolling", tabindex=0, role="region", aria_label=label)
