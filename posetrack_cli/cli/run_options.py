"""Options of every command that tracks: what to write, which configuration, which frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from posetrack_cli.cli.option_group import Command, option_group

if TYPE_CHECKING:
    from posetrack_cli.configuration import Settings

Config = TypeVar("Config", bound="Settings")

RUN_OPTIONS = ("output", "seed", "start", "end", "stride", "resume", "overwrite", "timings")
"""Names of those that ``tracking.options.RunOptions`` has, too."""


def result_options(shipped: str, example: str) -> Callable[[Command], Command]:
    """Return what adds --output, --config and --set to a command.

    Args:
        shipped: the configurations that are shipped for it, in words.
        example: of an assignment.
    """
    return option_group(
        click.option(
            "-o", "--output", required=True, type=click.Path(path_type=Path), help="Result to write, MCAP."
        ),
        click.option(
            "--config",
            "configs",
            multiple=True,
            help=f"TOML file, or a shipped name: {shipped}; repeatable, later ones override.",
        ),
        click.option(
            "--set",
            "settings",
            metavar="KEY=VALUE",
            multiple=True,
            help=f"Set any key of the configuration, such as {example}; repeatable.",
        ),
    )


frame_options = option_group(
    click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Random seed."),
    click.option("--start", type=click.IntRange(min=0), default=0, help="First frame."),
    click.option("--end", type=click.IntRange(min=1), help="Frame to stop before."),
    click.option("--stride", type=click.IntRange(min=1), default=1, help="Track every so many frames."),
)


def finishing_options(replaced: str) -> Callable[[Command], Command]:
    """Return what adds --resume, --overwrite and --timings to a command.

    Args:
        replaced: what --overwrite replaces, in words.
    """
    return option_group(
        click.option("--resume", is_flag=True, help="Go on with an interrupted run."),
        click.option("--overwrite", is_flag=True, help=f"Replace {replaced}."),
        click.option(
            "--timings",
            is_flag=True,
            help="Write each frame's milliseconds (bytes then differ from run to run).",
        ),
    )


def configuration_of(kind: type[Config], options: Mapping[str, Any], configured: Mapping[str, str]) -> Config:
    """Return the configuration: defaults < --config < --set < options.

    Args:
        kind: of configuration.
        options: of the command.
        configured: configuration key of each option that stands for one.

    Raises:
        UsageError: what cannot be meant.
    """
    from posetrack_cli.configuration import find_configuration, load_settings, parse_assignments

    files = [find_configuration(name) for name in options["configs"]]
    own = {key: options[name] for name, key in configured.items() if options[name] is not None}
    return load_settings(kind, files, parse_assignments(options["settings"]) | own)
