"""Redo section 7 of Kajihara and Tanaka's paper, and answer the question it leaves open.

Usage: scripts/reproduce hand [-o out/reproduce] [--seeds 20] [--kinect RECORDING ...]
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import click

from posetrack_cli.build import version
from posetrack_cli.cli.main import run as posetrack
from posetrack_cli.cli.options import recording_options
from posetrack_cli.errors import EXIT_DATA_LOST
from posetrack_cli.rendering.devices import open_fastest_device
from posetrack_cli.rendering.port import RenderingDevice
from reproduction import analysis, figures, report, study, timing
from reproduction.unit import ENTRANTS, Entrant, Unit, configuration, is_current, run_unit

FIGURE_SEED = 201
CONFIGURATIONS = {
    "hand-paper": "printed",
    "union cost, drawn from the motion": "union",
    "hand (default)": "default",
}
"""What rows of figures are called, and the entrants of ``unit`` that they show."""
PAIRS = {
    "PF against RBPF": (
        ("pf-printed", "rbpf-printed"),
        ("pf-paper", "rbpf-paper"),
        ("pf-union", "rbpf-union"),
    ),
    "The paper's cost against the union cost": (("pf-paper", "pf-union"), ("rbpf-paper", "rbpf-union")),
}
UNITS = {"joint_error_mm": "mm", "velocity_error_mm_s": "mm/s"}
LINEAR = {"joint_error_mm": 5.0, "velocity_error_mm_s": 50.0}
TITLES = {
    "joint_error_mm": "mean error of the 21 joints",
    "velocity_error_mm_s": "mean error of the wrist's velocity",
}


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "-o", "--output", default=Path("out/reproduce"), type=click.Path(path_type=Path), show_default=True
)
@click.option(
    "--seeds", default=20, show_default=True, type=click.IntRange(1), help="Recordings per condition."
)
@click.option(
    "--frames", default=150, show_default=True, type=click.IntRange(2), help="Frames per recording."
)
@click.option("--jobs", default=os.cpu_count() or 1, show_default=True, type=click.IntRange(1))
@click.option("--kinect", type=click.Path(path_type=Path), help="Real recording for figures 8 and 9.")
@click.option("--kinect-frames", default="0::20", show_default=True, help="Frames of it to show.")
@recording_options
def main(
    output: Path, seeds: int, frames: int, jobs: int, kinect: Path | None, kinect_frames: str, **options: Any
) -> None:
    """Redo the hand paper's experiments; everything goes to the output folder, and report.md tells about it.

    Tracks of this version that are there already are kept: an interrupted run goes on where it stopped. The
    options about recordings are those of posetrack hand run and belong to --kinect.
    """
    output.mkdir(parents=True, exist_ok=True)
    device = open_fastest_device()
    failures: list[str] = []
    parts = (
        _head(str(device.info), seeds, frames),
        _artificial(output, "A", (figures.WRIST_Y, figures.MIDDLE_BEND), "6", frames),
        _artificial(output, "B", (figures.WRIST_Y, figures.WRIST_X), "7", frames),
        _real(output, kinect, kinect_frames, options),
        _time(output, device),
        _study(output, seeds, frames, jobs, failures),
    )
    text = "\n".join(chain.from_iterable(parts)) + "\n"
    (output / "report.md").write_text(text, encoding="utf-8")
    click.echo(f"written: {output / 'report.md'}")
    if failures:
        click.echo(f"{len(failures)} recordings failed, first {failures[0]}", err=True)
        sys.exit(EXIT_DATA_LOST)


def _head(renderer: str, seeds: int, frames: int) -> Iterator[str]:
    yield "# The hand paper's experiments, redone"
    yield ""
    yield (
        "Kajihara and Tanaka, *3D hand pose tracking with a Rao-Blackwellized particle filter*, section 7, "
        f"by posetrack {version()}. PF is the plain particle filter, RBPF the Rao-Blackwellized one. "
        f"30 Hz. Study: {seeds} recordings of {frames} frames per condition. Renderer: {renderer}."
    )
    yield ""
    yield (
        "*hand-paper* is `--config hand-paper`: the paper as printed, as far as there are keys "
        "(`docs/method.md`); noise densities, which it does not print, are ours. *Union cost, drawn from the "
        "motion* is `hand.toml` with "
        f"{_changes(ENTRANTS['rbpf-union'])}. *hand (default)* is `hand.toml` itself, with the recording's "
        f"hand. They have {', '.join(map(_particles, CONFIGURATIONS.values()))} particles."
    )
    yield ""


def _particles(name: str) -> str:
    return str(configuration(f"rbpf-{name}").filter.particles)


def _changes(entrant: Entrant) -> str:
    """What an entrant changes of its configuration, but for the filter, which is each row's own."""
    changes = (f"`{key}={value}`" for key, value in entrant.changes.items() if key != "filter.kind")
    return ", ".join(changes)


def _artificial(
    output: Path, motion: str, components: Sequence[figures.Component], number: str, frames: int
) -> Iterator[str]:
    """Figures 6 and 7."""
    folder = output / "figures-runs"
    folder.mkdir(exist_ok=True)
    unit = Unit(motion, 1.0, FIGURE_SEED, frames)
    entrants = [f"{kind}-{values}" for values in CONFIGURATIONS.values() for kind in ("pf", "rbpf")]
    click.echo(f"figure {number}: motion {motion}", err=True)
    run_unit(unit, entrants, folder)
    rows = {
        title: {kind: unit.result(folder, f"{kind}-{values}") for kind in ("pf", "rbpf")}
        for title, values in CONFIGURATIONS.items()
    }
    picture = output / f"figure{number}.png"
    figures.trajectories(picture, rows, components)
    yield f"## Artificial data {motion} (figure {number})"
    yield ""
    yield from report.quoted(motion)
    yield f"![Truth, PF and RBPF]({picture.name})"
    yield ""
    yield from report.component_errors(rows, components)


def _real(output: Path, kinect: Path | None, frames: str, options: Mapping[str, Any]) -> Iterator[str]:
    """Figures 8 and 9."""
    yield "## Real depth (figures 8 and 9)"
    yield ""
    yield from report.quoted("real")
    if kinect is None:
        yield "Not redone: no real recording was given (`--kinect`)."
        yield ""
        return
    for number, kind in (("8", "pf"), ("9", "rbpf")):
        for title, values in CONFIGURATIONS.items():
            picture = output / f"figure{number}-{values}.png"
            result = _track_real(output, kinect, f"{kind}-{values}", options)
            sheet = ["--layout", "paper", "--select", frames, "--recording", str(kinect)]
            _command("view", str(result), "-o", str(picture), *sheet, *_given(options), "--overwrite")
            yield f"Figure {number}, {kind.upper()}, {title}: observed above, estimate below."
            yield ""
            yield f"![Observed and estimated depth]({picture.name})"
            yield ""


def _track_real(output: Path, kinect: Path, entrant: str, options: Mapping[str, Any]) -> Path:
    result = output / f"kinect-{entrant}.mcap"
    if not is_current(result, entrant):
        chosen = ENTRANTS[entrant]
        changes = [f"--set={key}={value}" for key, value in chosen.changes.items()]
        arguments = ["-o", str(result), "--config", chosen.configuration, *changes, "--set=output.mesh=none"]
        _command("hand", "run", str(kinect), *arguments, *_given(options), "--overwrite")
    return result


def _given(options: Mapping[str, Any]) -> list[str]:
    """The options about the recording, as they were typed."""
    arguments = []
    for name, value in options.items():
        flag = "--" + name.removesuffix("_file").replace("_", "-")
        if value is True:
            arguments += [flag]
        elif value not in (None, False):
            arguments += [flag, str(value)]
    return arguments


def _command(*arguments: str) -> None:
    code = posetrack(list(arguments))
    if code:
        sys.exit(code)


def _time(output: Path, device: RenderingDevice) -> Iterator[str]:
    """Figure 10."""
    click.echo("figure 10: time per frame", err=True)
    milliseconds = timing.frame_times(device)
    figures.times(output / "figure10.png", timing.PARTICLES, milliseconds)
    yield "## Time per frame (figure 10)"
    yield ""
    yield from report.quoted("time")
    yield "![Time per frame against particles](figure10.png)"
    yield ""
    yield from report.time_table(timing.PARTICLES, milliseconds)
    yield (
        f"Medians over {timing.RECORDING.frames - timing.WARM_UP} frames of motion B with the paper's "
        "values; the two filters take turns, frame by frame."
    )
    yield ""


def _study(output: Path, seeds: int, frames: int, jobs: int, failures: list[str]) -> Iterator[str]:
    """The question that the paper left open; recordings that fail are added to ``failures``."""
    units = {condition: condition.units(seeds, frames) for condition in study.CONDITIONS}
    every = [unit for of_condition in units.values() for unit in of_condition]
    folder = output / "runs"
    failures += study.run_units(every, study.STUDIED, folder, jobs)
    measured = analysis.measure(every, study.STUDIED, folder)
    yield "## Does velocity help? The question left open"
    yield ""
    yield from report.quoted("conclusion")
    yield (
        "A pair is one recording, tracked twice with the same seed. `paper` and `union` name the cost; "
        "particles are drawn from the motion, not by local fits; all else is as in `hand.toml`. `printed` is "
        "`hand-paper`. Errors are means over all frames of a recording, lost ones "
        "included; ± is the standard deviation over recordings; negative differences are in favour of the "
        "second. p adjusted: Benjamini and Hochberg over the table's rows. Motion A is a random walk without "
        "velocity."
    )
    yield ""
    yield from report.reliability_table(measured, study.STUDIED)
    for metric in analysis.METRICS:
        for title, pairs in PAIRS.items():
            yield from _compared(output, measured, units, metric, title, pairs)
    yield from _failed(failures)


def _compared(
    output: Path,
    measured: Mapping[tuple[str, str], analysis.Figures],
    units: Mapping[study.Condition, Sequence[Unit]],
    metric: str,
    title: str,
    pairs: Sequence[tuple[str, str]],
) -> Iterator[str]:
    compared = [c for pair in pairs for c in analysis.compare(measured, units, pair, metric)]
    if not compared:
        return
    name = f"study-{metric}-{'filter' if title.startswith('PF') else 'cost'}.png"
    labels = {
        f"{c.condition.motion}, speed {c.condition.speed:g}: {c.second} - {c.first}": (
            c.differences,
            c.summary,
        )
        for c in compared
    }
    heading = f"{title}: {TITLES[metric]}"
    figures.differences(output / name, heading, UNITS[metric], LINEAR[metric], labels)
    yield f"### {heading}"
    yield ""
    yield f"![Differences per recording]({name})"
    yield ""
    yield from report.study_table(compared, UNITS[metric])


def _failed(failures: Sequence[str]) -> Iterator[str]:
    if failures:
        yield f"{len(failures)} recordings failed and are left out:"
        yield ""
        yield from (f"- {failure}" for failure in failures)


if __name__ == "__main__":
    main()
