"""``posetrack head``: the commands about heads."""

from __future__ import annotations

import click

from posetrack_cli.cli.head_stereo import head_stereo
from posetrack_cli.cli.head_synth import head_synth


@click.group()
def head() -> None:
    """Track a head, or make recordings of one."""


head.add_command(head_stereo)
head.add_command(head_synth)
