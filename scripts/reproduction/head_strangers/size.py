"""One camera that is told how large a head is: by the distance of the pupils, or by another result."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from posetrack_cli.evaluation.truth.csv_track import load_csv_track
from posetrack_cli.geometry.rigid import in_object
from posetrack_cli.head.subject import head_subject
from reproduction.head_strangers.measuring import Measured
from reproduction.head_strangers.mono import judge_most, judged_people, mono_chain, people_table, rows_of
from reproduction.head_strangers.options import Options
from reproduction.heads_data import TRUTH, reading_arguments
from reproduction.one_camera.population import CAMERA, TRACKED
from reproduction.running import Targets
from reproduction.steps import FILE, Chain, Step

DISTANCE, PERSON = "told-distance", "told-person"
MEDIAN = {"x_mm": 1.0, "y_mm": 1.0, "z_mm": 4.0}
"""Asked for with the distance of the pupils."""
STEREO_FROM = 60
"""The first frame that two cameras see where one camera is told of their result: it sees others, too."""


class Told:
    """The left camera alone, told how large the person is."""

    name = "told"

    def chains(self, options: Options) -> list[Chain]:
        """Two for each stranger."""
        return [
            chain
            for folder in options.strangers
            for chain in (_distance(options, folder), _person(options, folder))
        ]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A row per person, and what was asked for."""
        yield "## One camera that is told how large a head is"
        yield ""
        yield (
            "With `--interpupillary-mm`, from the truth of the first frame, whose eyes' corners have pupils "
            "midway between:"
        )
        yield ""
        people = judged_people(options.strangers, DISTANCE, measured)
        yield from people_table(people, {}, DISTANCE, measured)
        rows = list(rows_of(people).values())
        for name, limit in MEDIAN.items():
            values = [row[name] for row in rows if name in row]
            value = float(np.median(values)) if values else float("nan")
            judge_most(
                targets, f"told the distance of pupils: {name.replace('_', ', ')}, median", limit, value
            )
        yield f"With `--person`, the result of two cameras that saw the frames from {STEREO_FROM} on:"
        yield ""
        yield from people_table(judged_people(options.strangers, PERSON, measured), {}, PERSON, measured)


def pupil_distance_mm(truth: Path) -> float:
    """Return how far apart the middles between the eyes' corners are in the first frame of a truth, mm."""
    track = load_csv_track(truth, head_subject(CAMERA, 0))
    assert track.points is not None and track.position is not None and track.quaternion is not None
    eyes = in_object(track.points[0, :4], track.position[0], track.quaternion[0])
    return float(np.linalg.norm(eyes[2:].mean(axis=0) - eyes[:2].mean(axis=0)))


def _distance(options: Options, folder: Path) -> Chain:
    told = ("--interpupillary-mm", f"{pupil_distance_mm(folder / TRUTH):.2f}")
    return mono_chain(options, folder, f"{folder.name}-{DISTANCE}", (*options.learned_without(folder), *told))


def _person(options: Options, folder: Path) -> Chain:
    name = f"{folder.name}-{PERSON}"
    reading, stereo = reading_arguments(folder, options.output / "recordings"), f"runs/{name}-stereo.mcap"
    first = ("head", "stereo", *reading, "--start", str(STEREO_FROM))
    arguments = (*options.learned_without(folder), "--person", f"{FILE}{stereo}")
    (tracked,) = mono_chain(options, folder, name, arguments).steps
    return Chain(name, TRACKED, (Step(stereo, first), tracked))
