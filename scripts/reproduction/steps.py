"""Files that posetrack's commands make of each other, each once: a chain of them in a process of its own.

Usage: PYTHONPATH=scripts .venv/bin/python -m reproduction.steps CHAIN OUT

CHAIN is a Chain as JSON. What the same code made of the same files with the same arguments is kept, so that a
study that was stopped goes on where it was.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from posetrack_cli.build import source_digest
from posetrack_cli.errors import PosetrackError
from reproduction.made import command, drawing_digest, is_made, mark_made, stamp_path
from reproduction.processes import run_modules

FILE = "@"
"""Arguments that begin with this are paths below the study's folder."""
DRAWS = ("head", "synth")
"""Begin of the commands whose output depends on the sources that draw heads alone."""


@dataclass(frozen=True)
class Step:
    """A file, and the command of posetrack that makes it.

    Attributes:
        output: path below the study's folder.
        arguments: of ``posetrack``, without ``-o``; those with ``FILE`` before them are outputs of earlier
            steps.
    """

    output: str
    arguments: tuple[str, ...]

    @property
    def inputs(self) -> tuple[str, ...]:
        """Outputs of earlier steps that it reads."""
        return tuple(one.removeprefix(FILE) for one in self.arguments if one.startswith(FILE))

    def command(self, out: Path) -> tuple[str, ...]:
        """The whole command, for a study in a folder."""
        given = (str(out / one.removeprefix(FILE)) if one.startswith(FILE) else one for one in self.arguments)
        return (*given, "-o", str(out / self.output), "--overwrite")


@dataclass(frozen=True)
class Chain:
    """Steps that one process does, one after the other.

    Attributes:
        name: what it is called in messages.
        stage: chains of a stage need nothing of one another, only of earlier stages.
        steps: in order.
    """

    name: str
    stage: int
    steps: tuple[Step, ...]

    @property
    def text(self) -> str:
        """As JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def of_text(cls, text: str) -> Chain:
        """The chain of a JSON text."""
        values = json.loads(text)
        steps = (Step(step["output"], tuple(step["arguments"])) for step in values["steps"])
        return cls(values["name"], values["stage"], tuple(steps))


@click.command()
@click.argument("chain", type=Chain.of_text)
@click.argument("out", type=click.Path(path_type=Path))
def main(chain: Chain, out: Path) -> None:
    """Make what is missing of a chain."""
    run_chain(chain, out)


def run_chain(chain: Chain, out: Path) -> None:
    """Make what is missing; a step that fails keeps only those from it that need its output.

    Raises:
        PosetrackError: steps failed; what their commands said is on standard error.
    """
    failed = [step.output for step in chain.steps if not (is_current(step, out) or _made(step, out))]
    if failed:
        raise PosetrackError(f"{chain.name}: failed: {', '.join(failed)}")


def run_chains(chains: Iterable[Chain], out: Path, jobs: int) -> list[str]:
    """Run chains stage by stage, so many at a time; return what went wrong, a line for each chain.

    Args:
        chains: equal ones are run once.
        out: the study's folder.
        jobs: processes at a time.
    """
    wanted = list(dict.fromkeys(chains))
    failures: list[str] = []
    for stage in sorted({chain.stage for chain in wanted}):
        missing = [chain for chain in wanted if chain.stage == stage and not _all_current(chain, out)]
        commands: Mapping[str, Sequence[str]] = {
            chain.name: ["reproduction.steps", chain.text, str(out)] for chain in missing
        }
        failures += run_modules(commands, jobs, f"stage {stage + 1}") if commands else []
    return failures


def _all_current(chain: Chain, out: Path) -> bool:
    return all(is_current(step, out) for step in chain.steps)


def _made(step: Step, out: Path) -> bool:
    """Run a step's command; say whether it went well."""
    path = out / step.output
    path.parent.mkdir(parents=True, exist_ok=True)
    stamp_path(path).unlink(missing_ok=True)  # an old output is not this step's, whatever happens now
    try:
        facts = _facts(step, out)
        command(*step.command(out))
    except PosetrackError as error:
        click.echo(str(error), err=True)
        return False
    mark_made(path, facts)
    return True


def is_current(step: Step, out: Path) -> bool:
    """Whether the output is there that the same code makes of the files that are there now."""
    inputs_known = all(stamp_path(out / name).exists() for name in step.inputs)
    return inputs_known and is_made(out / step.output, _facts(step, out))


def _facts(step: Step, out: Path) -> dict[str, object]:
    """What an output depends on.

    Raises:
        PosetrackError: an input is missing.
    """
    digest: Callable[[], str] = drawing_digest if step.arguments[: len(DRAWS)] == DRAWS else source_digest
    inputs = {name: _known(out / name) for name in step.inputs}
    return {"arguments": step.arguments, "inputs": inputs, "code": digest()}


def _known(path: Path) -> object:
    """What an input was made of."""
    try:
        return json.loads(stamp_path(path).read_text("utf-8"))
    except OSError as error:
        raise PosetrackError(f"{path} was not made") from error


if __name__ == "__main__":
    main()
