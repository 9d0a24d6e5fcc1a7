"""The ``posetrack`` command group; turns every error into one line and an exit code."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import click

from posetrack_cli.cli.batch import batch
from posetrack_cli.cli.calibrate import calibrate
from posetrack_cli.cli.command import HELP_NAMES
from posetrack_cli.cli.doctor import doctor
from posetrack_cli.cli.eval import evaluate
from posetrack_cli.cli.export import convert, export
from posetrack_cli.cli.hand import hand
from posetrack_cli.cli.head import head
from posetrack_cli.cli.info import info
from posetrack_cli.cli.process import (
    fork_under_memory_limit,
    is_debugging,
    leave_process,
    prepare_process,
    terminate_as_interrupted,
)
from posetrack_cli.cli.terminal import discard_output, print_line, print_note
from posetrack_cli.cli.view import view
from posetrack_cli.errors import EXIT_DONE, EXIT_FAILED, EXIT_INTERRUPTED, PosetrackError, error_words

# CPython's message for every limit on threads; it raises a plain RuntimeError
_NO_THREAD = "can't start new thread"


class _Group(click.Group):
    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interruption:  # click itself would print an empty line first
            raise click.Abort from interruption


def _print_version(context: click.Context, _: click.Parameter, value: bool) -> None:
    from posetrack_cli.build import build_name

    if value:
        print_line(f"posetrack, version {build_name()}")
        context.exit()


@click.group(cls=_Group, context_settings={**HELP_NAMES, "max_content_width": 100})
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Show the version and exit.",
)
def cli() -> None:
    """Track hands in recorded depth and heads in recorded video.

    Reads MCAP files, ROS bags, videos and image folders; estimates pose, velocity and shape with
    uncertainties.

    Exit codes: 0 success; 1 error; 2 usage error; 3 finished, but some data was lost or skipped; 130
    interrupted. Results go to stdout, diagnostics to stderr; progress bars appear only on a terminal. Set
    POSETRACK_DEBUG=1 to see tracebacks and library output.
    """


for command in (hand, head, batch, evaluate, view, export, info, convert, calibrate, doctor):
    cli.add_command(command)


def main() -> None:
    """Run posetrack on ``sys.argv`` and exit."""
    # The order matters: BLAS settings must precede the import of numpy, and a fork must precede all threads.
    prepare_process()
    terminate_as_interrupted()
    fork_under_memory_limit()
    leave_process(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run a command line, print any error as one line, and return the exit code."""
    return run_safely(lambda: _done(arguments))


def run_safely(work: Callable[[], int]) -> int:
    """Call ``work``, print any error as one line, and return the exit code."""
    try:
        return work()
    except PosetrackError as error:
        return _failed(str(error), error.exit_code)
    # A ClickException whose message is the help; shown as it is, not as one line.
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return error.exit_code
    except click.ClickException as error:
        return _failed(_usage_line(error), error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        return _failed("interrupted", EXIT_INTERRUPTED)
    # The reader of the output has gone, for example `head`; there is nobody to report to.
    except BrokenPipeError:
        discard_output()
        return EXIT_FAILED
    except OSError as error:
        discard_output()
        return _failed(f"{error.filename or 'output'}: {error.strerror or error}", EXIT_FAILED)
    except MemoryError as error:
        return _failed(_memory_line(error), EXIT_FAILED)
    except Exception as error:
        return _failed(_unexpected_line(error), EXIT_FAILED)


def _done(arguments: list[str]) -> int:
    # Standalone mode would print errors itself and exit.
    code = cli.main(args=arguments, prog_name="posetrack", standalone_mode=False)
    if sys.stdout is not None:
        sys.stdout.flush()
    return code if isinstance(code, int) else EXIT_DONE


def _failed(message: str, code: int) -> int:
    with suppress(OSError):  # standard error may be closed or full
        if is_debugging():
            traceback.print_exc()
        print_note(f"posetrack: {message}")
    return code


def _memory_line(error: MemoryError) -> str:
    detail = f" ({error})" if str(error) else ""
    return f"out of memory{detail}; use smaller images, fewer frames or fewer --particles"


def _unexpected_line(error: Exception) -> str:
    if _NO_THREAD in str(error):
        return "out of memory or threads: raise ulimit -v or -u, or set POSETRACK_THREADS=1"
    if isinstance(error, ModuleNotFoundError) and not str(error.name).startswith("posetrack_cli"):
        return f"{error.name} is not installed; install posetrack with all dependencies"
    # Any other exception is a bug; the fuzzing harness counts this line as a failure.
    return (
        f"internal error: {error_words(error)}; this is a bug, please report it with the output of "
        "POSETRACK_DEBUG=1"
    )


def _usage_line(error: click.ClickException) -> str:
    """Return click's message on one line, with a pointer to the command's help."""
    message = " ".join(error.format_message().split()).removesuffix(".")
    context = getattr(error, "ctx", None)
    return message if context is None else f"{message}; see: {context.command_path} --help"


if __name__ == "__main__":
    main()
