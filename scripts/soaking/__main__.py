"""Long runs, 100 kills, full disks and cold kernel caches: nothing may grow, and nothing may be lost.

Every run is a process of its own, started as a user starts it. Prints a table, and one line for whatever is
not as it must be; the exit code is 1 if there is any.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import FrameType

import click

from soaking.amounts import FULL, QUICK
from soaking.cases import TRACKERS
from soaking.findings import Findings
from soaking.parts import PARTS, describe, soak, workplace


@click.command()
@click.option("--only", type=click.Choice(PARTS), multiple=True, help="Only this; repeatable.")
@click.option("--tracker", type=click.Choice(TRACKERS), multiple=True, help="Only this; repeatable.")
@click.option("--frames", type=click.IntRange(min=60), help="Of each long run.  [default: 20000]")
@click.option("--kills", type=click.IntRange(min=1), help="Of runs, and of batches.  [default: 100]")
@click.option("--disks", type=click.IntRange(min=1), help="Sizes for each tracker.  [default: 10]")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the moments of the kills.")
@click.option("--json", "as_json", type=click.Path(path_type=Path), help="Write the figures here.")
@click.option("--markdown", "as_markdown", type=click.Path(path_type=Path), help="Write them as tables.")
@click.option("--keep", type=click.Path(path_type=Path), help="Work in this new folder and leave it.")
@click.option("--quick", is_flag=True, help="See that everything works; its figures are not to be quoted.")
def main(
    only: Sequence[str],
    tracker: Sequence[str],
    seed: int,
    as_json: Path | None,
    as_markdown: Path | None,
    keep: Path | None,
    quick: bool,
    **given: int | None,
) -> None:
    """Let trackers run long, kill them, fill their disk, start them cold; exit code 1 if any suffers."""
    signal.signal(signal.SIGTERM, _leave)  # what is mounted is unmounted
    amounts = replace(QUICK if quick else FULL, **{name: n for name, n in given.items() if n is not None})
    machine = describe(amounts, seed)
    for key, value in machine.items():
        print(f"{key}: {value}", flush=True)
    findings = Findings()
    with workplace(keep) as folder:
        soak(only or PARTS, tracker or TRACKERS, amounts, seed, folder, findings)
    for path, text in ((as_json, findings.as_json(machine)), (as_markdown, findings.as_markdown(machine))):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
            print(f"written: {path}")
    print(f"not as it must be: {len(findings.troubles)}")
    sys.exit(1 if findings.troubles else 0)


def _leave(number: int, frame: FrameType | None) -> None:
    sys.exit(128 + number)


if __name__ == "__main__":
    main(prog_name="scripts/soak")
