"""Joint errors of hand-tracking configurations on synthetic recordings: a Markdown table.

Usage: .venv/bin/python scripts/accuracy.py --motion C --speed 1 --seeds 101-106

Every configuration tracks the same frames. C starts as ``--init center`` does, A and B from the true pose,
which is nowhere in particular. A recording's figure is the mean over its frames and 21 joints; the table has
the mean, smallest and largest over recordings. Lost frames are those that the tracker calls lost; their
errors count.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import click
import numpy as np

from posetrack_cli.configuration import find_configuration, load_settings
from posetrack_cli.hand.anatomy import make_anatomy
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.likelihood import RenderedCosts
from posetrack_cli.hand.start import centre_pose
from posetrack_cli.hand.synthesis.frames import SyntheticFrame, synthesise
from posetrack_cli.hand.synthesis.options import Switches, SynthOptions
from posetrack_cli.hand.synthesis.sensor import CAMERA
from posetrack_cli.hand.tracker import HandState, HandTracker
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.context import open_context

CONFIGURATIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "hand.toml (RBPF)": ("hand", {}),
    "hand.toml, --filter pf": ("hand", {"filter.kind": "pf"}),
    "hand-paper.toml": ("hand-paper", {}),
}


@dataclass
class Entrant:
    """One configuration's run over one recording."""

    config: HandConfig
    tracker: HandTracker
    from_centre: bool
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    state: HandState | None = None
    errors: list[float] = field(default_factory=list)
    lost: int = 0

    def step(self, frame: SyntheticFrame, depth: Any) -> None:
        """Track a frame and note its error."""
        if self.state is None:
            pose = frame.pose
            if self.from_centre:
                pose = centre_pose(depth, CAMERA, self.tracker.anatomy, self.config.init.depth_mm)
            self.state = self.tracker.start(pose, frame.stamp_ns, self.rng)
        seen = Frame(frame.index, frame.stamp_ns, (depth,))
        self.state, estimate = self.tracker.step(self.state, seen, self.rng)
        self.errors.append(float(np.linalg.norm(estimate.points - frame.joints, axis=1).mean()))
        self.lost += estimate.status == "lost"


@click.command()
@click.option("--motion", type=click.Choice(["A", "B", "C"]), default="C", show_default=True)
@click.option("--speed", default=1.0, show_default=True)
@click.option("--seeds", default="101-106", show_default=True, help="First and last seed.")
@click.option("--frames", default=300, show_default=True)
def main(motion: str, speed: float, seeds: str, frames: int) -> None:
    """Measure the joint errors of the shipped configurations."""
    context = open_context()
    first, last = (int(number) for number in seeds.split("-"))
    results: dict[str, list[Entrant]] = {name: [] for name in CONFIGURATIONS}
    for seed in range(first, last + 1):
        options = SynthOptions(motion, frames, seed, speed, switches=Switches.usual(motion))
        entrants = {name: enter(name, motion, context) for name in CONFIGURATIONS}
        for frame in synthesise(options, context=context):
            depth = frame.depth.astype(np.float32)
            for entrant in entrants.values():
                entrant.step(frame, depth)
        for name, entrant in entrants.items():
            results[name].append(entrant)
    print(f"| motion {motion}, speed {speed:g}, seeds {seeds} | mean, mm | smallest, largest, mm | lost |")
    print("|---|---|---|---|")
    for name, runs in results.items():
        means = [np.mean(run.errors) for run in runs]
        lost = sum(run.lost for run in runs)
        print(f"| {name} | {np.mean(means):.1f} | {min(means):.1f}, {max(means):.1f} | {lost} |")


def enter(name: str, motion: str, context: Any) -> Entrant:
    """A configuration, ready for its first frame."""
    file, options = CONFIGURATIONS[name]
    config = load_settings(HandConfig, find_configuration(file), options)
    anatomy = make_anatomy()
    scorer = RenderedCosts(context, anatomy, CAMERA, config.observation, config.filter.particles)
    return Entrant(config, HandTracker(config, anatomy, CAMERA, scorer), motion == "C")


if __name__ == "__main__":
    main()
