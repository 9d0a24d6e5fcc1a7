"""Where reports are written: whole or not at all, and never over what an evaluation reads."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from posetrack_cli.errors import UsageError
from posetrack_cli.files import real_path, write_output
from posetrack_cli.outputs import check_free, check_place, whole_or_nothing


def check_reports(reports: Iterable[Path], inputs: Iterable[Path], *, overwrite: bool) -> None:
    """Refuse reports that cannot be written, before time is spent on what stands in them.

    Args:
        reports: files to write.
        inputs: files that are read.
        overwrite: whether existing reports may be replaced.

    Raises:
        UsageError: a report is a folder, a device, an input, the same file as another, or is there already.
        ResultError: its folder does not exist.
    """
    taken = {real_path(path): "an input" for path in inputs}
    for report in reports:
        check_place(report)
        if report.exists() and not report.is_file():  # a device would be replaced, not written to
            found = "a folder" if report.is_dir() else "a device"
            hint = "- is standard output"
            raise UsageError("report cannot be written", where=report, found=found, hint=hint)
        use = taken.get(real_path(report))
        if use:
            raise UsageError(f"report would replace {use}", where=report, hint="choose another name")
        if not overwrite:
            check_free(report)
        taken[real_path(report)] = "another report"


def write_report(path: Path, text: str) -> None:
    """Write a report as UTF-8; a name that is no text is written as an escape that JSON reads back.

    Raises:
        ResultError: it cannot be written.
    """
    with whole_or_nothing(path) as part:
        write_output(part, text.encode("utf-8", "backslashreplace"))
