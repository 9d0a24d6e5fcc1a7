"""Compute digests of the output of every command, on generated recordings.

Steps are command lines with relative paths in a new folder, so their output depends only on the code and the
machine. Runs before and after a change of the code show whether any result changed.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import click

ROOT = Path(__file__).resolve().parents[2]


def check_package(package: Path) -> None:
    """Check that the commands would run the package of a checkout, and not an installed one."""
    line = [sys.executable, "-c", "import posetrack_cli; print(posetrack_cli.__file__)"]
    with tempfile.TemporaryDirectory() as elsewhere:
        found = subprocess.run(
            line, cwd=elsewhere, env={"PYTHONPATH": str(package)}, capture_output=True, text=True, check=True
        )
    if Path(found.stdout.strip()).parents[1].resolve() != package:
        raise click.UsageError(f"{package} does not contain posetrack_cli; {found.stdout.strip()} would run")


@click.command()
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Write the digests as JSON.")
@click.option("--against", type=click.Path(path_type=Path, exists=True), help="Compare with earlier digests.")
@click.option("--only", multiple=True, metavar="NAME", help="Only this group or step, and its dependencies.")
@click.option(
    "--package", type=click.Path(path_type=Path, exists=True), help="Checkout to run.  [default: this one]"
)
@click.option("--keep", type=click.Path(path_type=Path), help="Work in this new folder and keep it.")
def main(
    output: Path | None, against: Path | None, only: Sequence[str], package: Path | None, keep: Path | None
) -> None:
    """Compute digests of the output of every command; exit code 1 if any differs or a step fails.

    Groups: recordings, conversions, hand, head, exports, reports, pictures, calibrations, batches.
    """
    package = (package or ROOT).resolve()
    check_package(package)
    sys.path[:0] = [str(package), str(ROOT / "tests"), str(ROOT / "scripts")]
    from digesting.steps import groups
    from digesting.workplace import Workplace, chosen, differences

    began, now, failed = time.monotonic(), dict[str, dict[str, str]](), 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=keep is None)
        workplace = Workplace(folder.resolve(), package)
        for step in chosen(groups(), only):
            try:
                now[step.name] = workplace.digest(step)
            except Exception as error:  # continue with the other steps
                failed += 1
                now[step.name] = {"failed": repr(error)}
                print(f"failed: {step.name}: {error!r}", file=sys.stderr)
            if output is not None:
                output.write_text(json.dumps(now, indent=1) + "\n")
            print(f"{time.monotonic() - began:7.1f} s  {step.name}", file=sys.stderr, flush=True)
    print(f"{sum(len(d) for d in now.values())} digests of {len(now)} steps, {failed} failed")
    lines = [] if against is None else list(differences(json.loads(against.read_text()), now))
    if against is not None:
        print("\n".join(lines or ["nothing differs"]))
    sys.exit(1 if lines or failed else 0)


if __name__ == "__main__":
    main(prog_name="scripts/digests")
