"""The command ``posetrack``: one group, and the way every error becomes one line and an exit code."""

from __future__ import annotations

import os
import sys

import click

from posetrack_cli import __version__
from posetrack_cli.cli.convert import convert
from posetrack_cli.cli.doctor import doctor
from posetrack_cli.cli.hand import hand
from posetrack_cli.cli.info import info
from posetrack_cli.errors import EXIT_FAILED, EXIT_INTERRUPTED, PosetrackError


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="posetrack")
def cli() -> None:
    """Track hands in recorded depth: pose, velocity and shape with their uncertainty, from MCAP or folders.

    Exit codes: 0 done; 1 failed; 2 wrong usage; 3 finished, but some data was lost or skipped; 130 stopped by
    Ctrl-C. Results go to standard output, diagnostics and progress to standard error.
    """


for command in (hand, info, convert, doctor):
    cli.add_command(command)


def main() -> None:
    """Run the command line and exit."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run a command line, print an error as one line, and return the exit code."""
    try:
        code = cli.main(args=arguments, prog_name="posetrack", standalone_mode=False)
        sys.stdout.flush()
        return code if isinstance(code, int) else 0
    except PosetrackError as error:
        click.echo(f"posetrack: {error}", err=True)
        return error.exit_code
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        click.echo("posetrack: interrupted", err=True)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # the reader of our output has gone: what is buffered goes nowhere, and exit must not try again
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILED
    except MemoryError:
        click.echo("posetrack: out of memory; try fewer --particles", err=True)
        return EXIT_FAILED


if __name__ == "__main__":
    main()
