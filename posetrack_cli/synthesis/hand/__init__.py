"""Synthetic recordings of a hand: the paper's random walks and natural motion, seen by a Kinect, with truth.

``synthesise(options)`` yields frames, ``write_synthetic(options, path)`` writes a file. A recording is a
function of its options::

    options: SynthOptions -> Plan (instants, motion) -> Scene, room, sensor -> SyntheticFrame -> MCAP

The names below are imported when they are first used: OpenCV, MCAP and protobuf take long to load.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from posetrack_cli.synthesis.hand.frames import Plan, SyntheticFrame, make_plan, render_plan, synthesise
    from posetrack_cli.synthesis.hand.options import MOTIONS, SIDES, SWITCH_NAMES, Switches, SynthOptions
    from posetrack_cli.synthesis.hand.sensor import CAMERA
    from posetrack_cli.synthesis.hand.truth import SUBJECT, truth_estimate
    from posetrack_cli.synthesis.hand.walk import Densities, WalkNoise
    from posetrack_cli.synthesis.hand.writing import SYNTH_RECORD, Synthesis, write_synthetic

__all__ = [
    "CAMERA",
    "MOTIONS",
    "SIDES",
    "SUBJECT",
    "SWITCH_NAMES",
    "SYNTH_RECORD",
    "Densities",
    "Plan",
    "Switches",
    "SynthOptions",
    "Synthesis",
    "SyntheticFrame",
    "WalkNoise",
    "make_plan",
    "render_plan",
    "synthesise",
    "truth_estimate",
    "write_synthetic",
]

_MODULES = {
    "frames": ("Plan", "SyntheticFrame", "make_plan", "render_plan", "synthesise"),
    "options": ("MOTIONS", "SIDES", "SWITCH_NAMES", "Switches", "SynthOptions"),
    "sensor": ("CAMERA",),
    "truth": ("SUBJECT", "truth_estimate"),
    "walk": ("Densities", "WalkNoise"),
    "writing": ("SYNTH_RECORD", "Synthesis", "write_synthetic"),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
