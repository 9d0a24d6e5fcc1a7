"""The command ``posetrack``: one group, and the way every error becomes one line and an exit code."""

from __future__ import annotations

import io
import sys
from contextlib import suppress

import click

from posetrack_cli import __version__
from posetrack_cli.cli.calibrate import calibrate
from posetrack_cli.cli.convert import convert
from posetrack_cli.cli.doctor import doctor
from posetrack_cli.cli.eval import evaluate
from posetrack_cli.cli.export import export
from posetrack_cli.cli.hand import hand
from posetrack_cli.cli.head import head
from posetrack_cli.cli.info import info
from posetrack_cli.cli.standard_output import discard_output
from posetrack_cli.cli.view import view
from posetrack_cli.errors import EXIT_DONE, EXIT_FAILED, EXIT_INTERRUPTED, PosetrackError


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="posetrack")
def cli() -> None:
    """Track hands in recorded depth: pose, velocity and shape with their uncertainty, from MCAP or folders.

    Exit codes: 0 done; 1 failed; 2 wrong usage; 3 finished, but some data was lost or skipped; 130 stopped by
    Ctrl-C. Results go to standard output, diagnostics and progress to standard error.
    """


for command in (hand, head, evaluate, view, export, info, convert, calibrate, doctor):
    cli.add_command(command)


def main() -> None:
    """Run the command line and exit."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # not so where it is closed
            stream.reconfigure(errors="backslashreplace")  # a name that it cannot show is no reason to fail
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run a command line, print an error as one line, and return the exit code."""
    try:
        code = cli.main(args=arguments, prog_name="posetrack", standalone_mode=False)
        if sys.stdout is not None:
            sys.stdout.flush()
        return code if isinstance(code, int) else EXIT_DONE
    except PosetrackError as error:
        return _failed(str(error), error.exit_code)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return error.exit_code
    except click.ClickException as error:
        return _failed(_usage_line(error), error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        return _failed("interrupted", EXIT_INTERRUPTED)
    except BrokenPipeError:
        discard_output()
        return EXIT_FAILED
    except OSError as error:
        discard_output()
        return _failed(f"{error.filename or 'output'}: {error.strerror or error}", EXIT_FAILED)
    except MemoryError:
        return _failed("out of memory; try fewer --particles", EXIT_FAILED)


def _failed(message: str, code: int) -> int:
    """Print one line on standard error, if anyone can read it, and return the exit code."""
    with suppress(OSError):
        click.echo(f"posetrack: {message}", err=True)
    return code


def _usage_line(error: click.ClickException) -> str:
    """Click's message on one line, and which help to read."""
    message = " ".join(error.format_message().split()).removesuffix(".")
    context = getattr(error, "ctx", None)
    return message if context is None else f"{message}; see: {context.command_path} --help"


if __name__ == "__main__":
    main()
