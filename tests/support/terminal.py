"""A terminal, and what its screen shows."""

from __future__ import annotations

import io


class Terminal(io.StringIO):
    """A stream that says that a person looks at it."""

    def isatty(self) -> bool:
        return True

    @property
    def lines(self) -> list[str]:
        """What the screen shows."""
        return screen(self.getvalue())


def screen(written: str, columns: int = 80) -> list[str]:
    """Return the lines that a screen shows, at least one: what goes beyond its width goes on below.

    Only what moves to the line's begin and to the next line is known, as nothing else may be written.
    """
    lines, at = [""], 0
    for char in written.removesuffix("\n").removesuffix("\r"):
        assert char in "\r\n" or char.isprintable(), f"{char!r} in {written!r}"
        if char == "\r":
            at = 0
            continue
        if char == "\n" or at == columns:
            lines, at = [*lines, ""], 0
        if char != "\n":
            lines[-1] = lines[-1][:at] + char + lines[-1][at + 1 :]
            at += 1
    return [line.rstrip() for line in lines]
