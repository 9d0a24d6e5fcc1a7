"""A made-up tracker as a program: ``FRAMES [--flaw FLAW] -o OUTPUT [--end N] [--resume | --overwrite]``."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

from posetrack_cli.errors import ResultError
from posetrack_cli.results import ResultWriter
from support.results import CAMERA, RUN, SUBJECT, checkpoint_at, make_estimate

FRAME_S = 0.02


def track(options: argparse.Namespace) -> None:
    """Write the frames, those after the checkpoint if it is to be resumed; with a flaw, not quite so."""
    if options.resume:
        writer, checkpoint = ResultWriter.resume(options.output, SUBJECT, CAMERA, RUN)
        begin = checkpoint.frame_index + 1
    else:
        writer, begin = ResultWriter(options.output, SUBJECT, CAMERA, RUN, overwrite=options.overwrite), 0
        writer.save_checkpoint(checkpoint_at(writer, -1))
    kept = []
    with writer:
        for index in range(begin, min(options.frames, options.end)):
            time.sleep(FRAME_S)
            cost = 1.0 if options.flaw == "resumes wrongly" and options.resume and index == begin else None
            kept.append(bytearray(4 << 20 if options.flaw == "grows" else 1))
            if writer.write(replace(make_estimate(index), cost=cost, milliseconds=1.0)):
                writer.save_checkpoint(checkpoint_at(writer, index))
        writer.finish({})


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("frames", type=int)
    parser.add_argument("--flaw")
    parser.add_argument("-o", dest="output", type=Path)
    parser.add_argument("--end", type=int, default=1 << 30)
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--overwrite", action="store_true")
    options = parser.parse_args()
    try:
        track(options)
    except ResultError as error:
        print(f"posetrack: {error}", file=sys.stderr)
        sys.exit(1)
