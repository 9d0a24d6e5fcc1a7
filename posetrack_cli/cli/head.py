"""``posetrack head``: the commands about heads."""

from __future__ import annotations

import click

from posetrack_cli.cli.head_build_model import head_build_model
from posetrack_cli.cli.head_mono import head_mono
from posetrack_cli.cli.head_stereo import head_stereo
from posetrack_cli.cli.head_synth import head_synth


@click.group()
def head() -> None:
    """Track a head, or make recordings of one."""


head.add_command(head_build_model)
head.add_command(head_mono)
head.add_command(head_stereo)
head.add_command(head_synth)
