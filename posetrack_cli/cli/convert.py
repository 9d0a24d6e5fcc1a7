"""``posetrack convert``: write a recording as one MCAP file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from posetrack_cli.cli.recording_options import opening_arguments, recording_options
from posetrack_cli.errors import EXIT_DATA_LOST


@click.command(short_help="Write a recording as one MCAP file, without loss.")
@click.argument("recording", metavar="IN", type=click.Path(path_type=Path))
@click.argument("out", metavar="OUT.mcap", type=click.Path(path_type=Path))
@recording_options
@click.option("--overwrite", is_flag=True, help="Replace OUT.mcap if it exists.")
def convert(recording: Path, out: Path, overwrite: bool, **options: Any) -> None:
    """Write IN, a folder of depth images or an MCAP file, as Foxglove MCAP without loss.

    Depth in whole millimetres is stored as 16-bit PNG, copied unchanged where IN has just that; other
    depth as 32-bit metres. Exit code 3 means that frames were lost.
    """
    from posetrack_cli.recording.conversion import convert_recording
    from posetrack_cli.recording.losses import loss_line
    from posetrack_cli.recording.opening import open_recording

    source = open_recording(recording, **opening_arguments(options))
    conversion = convert_recording(source, out, overwrite=overwrite)
    click.echo(f"{out}: {conversion.frames} frames, {out.stat().st_size} bytes")
    if conversion.losses:
        click.echo(f"{recording}: {loss_line(conversion.losses)}", err=True)
        click.get_current_context().exit(EXIT_DATA_LOST)
