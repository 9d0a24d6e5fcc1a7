"""``posetrack head``: head commands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from posetrack_cli.cli.command import Command, option, volume_options
from posetrack_cli.cli.head_run import head_mono, head_stereo
from posetrack_cli.cli.options import FILE, WRITTEN, output_option, overwrite_option
from posetrack_cli.cli.synth import head_synth
from posetrack_cli.cli.terminal import print_line, print_note
from posetrack_cli.errors import EXIT_DATA_LOST, UsageError

if TYPE_CHECKING:
    from posetrack_cli.arrays import FloatArray
    from posetrack_cli.head.multilinear.face_model import FaceModel
    from posetrack_cli.head.multilinear.learning import LearnedModel, ObservedFace


# posetrack head build-model


@click.command(
    "build-model",
    cls=Command,
    examples=(
        "posetrack head build-model anna.mcap ben.mcap -o face.npz --picture face.png",
        "posetrack head mono video.mp4 --face-model face.npz -o head.mcap",
    ),
    former={"--identity": "--identity-size", "--deformation": "--deformation-size"},
    short_help="Build a face model for head mono from stereo results.",
)
@click.argument("results", metavar="RESULT...", nargs=-1, required=True, type=FILE)
@output_option("Output file: the face model.", "FACE.npz")
@overwrite_option("FACE.npz and the --picture file if they exist")
@option(
    "--identity-size",
    metavar="N",
    type=click.IntRange(min=1, max=100),
    default=10,
    show_default=True,
    help="Number of identity parameters (S').",
    group="Model",
)
@option(
    "--deformation-size",
    metavar="N",
    type=click.IntRange(min=1, max=10),
    default=5,
    show_default=True,
    help="Number of deformation (action) parameters (A').",
    group="Model",
)
@option(
    "--picture",
    metavar="FILE.png",
    type=FILE,
    help="Also draw the model: identities in rows, deformations in columns.",
    group=WRITTEN,
)
@volume_options
def head_build_model(
    results: tuple[Path, ...],
    output: Path,
    identity_size: int,
    deformation_size: int,
    picture: Path | None,
    overwrite: bool,
) -> None:
    """Build a face model from RESULTs of posetrack head stereo, one per person.

    In each recording, the person makes the mouth wide and narrow and the face long and short (brows and jaw
    together), each several times. At least two people are required, five for 10 identity parameters. Use
    the model with posetrack head mono RECORDING --face-model FACE.npz.
    """
    from posetrack_cli.head.multilinear.face_model import save_face_model
    from posetrack_cli.head.multilinear.learning import learn_model, read_face

    _check_outputs(results, output, picture, overwrite=overwrite)
    faces = [read_face(path) for path in results]
    learned = learn_model(faces, identity_size, deformation_size)
    _print_limits(learned, identity_size, deformation_size)
    _show(learned)
    model = learned.built.model
    save_face_model(output, model, f"{len(faces)} results of posetrack head stereo")
    if picture is not None:
        _draw(model, picture)
    print_line(f"{output}: identity {model.identity_size}, deformation {model.deformation_size}")
    _print_losses(faces)


def _check_outputs(results: Sequence[Path], output: Path, picture: Path | None, *, overwrite: bool) -> None:
    from posetrack_cli.outputs import check_target

    if picture is not None and picture.suffix.lower() != ".png":
        raise UsageError("--picture is not a PNG file name", where=picture, expected="a name ending in .png")
    if picture is not None and picture.resolve() == output.resolve():
        raise UsageError("--output and --picture are the same file", where=output)
    files = [path.resolve() for path in results]
    again = [path for number, path in enumerate(results) if files[number] in files[:number]]
    if again:
        raise UsageError("result given twice", where=again[0], expected="one result per person")
    for written in (output,) if picture is None else (output, picture):
        for source in results:
            check_target(written, overwrite=overwrite, source=source, source_name="result")


def _print_limits(learned: LearnedModel, *asked: int) -> None:
    people, names = len(learned.faces), ("identity", "deformation")
    for name, wanted, possible in zip(names, asked, learned.possible, strict=True):
        if wanted > possible:
            print_note(f"{name}: {possible} instead of {wanted} parameters, the most for {people} people")


def _show(learned: LearnedModel) -> None:
    """Print tables of the people, the approximation error and the variance per parameter."""
    from posetrack_cli.head.multilinear.build import cumulative_contribution, distances_by_kind

    _show_people(learned)
    built = learned.built
    errors = distances_by_kind(built.approximations() - built.samples)
    print_line()
    print_line(" " * 24 + "".join(f"{name:>10}" for name in errors))
    print_line(f"{'approximation, rms mm':<24}" + "".join(f"{error:>10.2f}" for error in errors.values()))
    names = ("identity", "deformation")
    sizes = (built.model.identity_size, built.model.deformation_size)
    print_line()
    print_line("cumulative contribution, % (kept | left out)")
    for name, spectrum, size in zip(names, built.spectra, sizes, strict=True):
        print_line(f"{name:<24}{_shares(100.0 * cumulative_contribution(spectrum), size)}")


def _show_people(learned: LearnedModel) -> None:
    from posetrack_cli.head.multilinear.learning import MOTIONS, RATES

    width = max(6, *(len(face.path.name) for face in learned.faces))
    rates = "".join(f"{100 * rate:>5.0f}%" for rate in RATES)
    print_line(f"{'':<{width}}{'':>14}" + "".join(f"  {name:>{15 + len(rates)}}" for name in MOTIONS))
    heads = f"  {'l, mm':>15}{rates}" * len(MOTIONS)
    print_line(f"{'person':<{width}}{'frames':>7}{'used':>7}{heads}")
    for face, motions in zip(learned.faces, learned.examples, strict=True):
        cells = (
            f"  {f'{one.lowest:.1f} to {one.highest:.1f}':>15}"
            + "".join(f"{count:>6}" for count in one.counts)
            for one in motions
        )
        print_line(f"{face.path.name:<{width}}{face.frames:>7}{len(face.shapes):>7}{''.join(cells)}")


def _shares(percent: FloatArray, kept: int) -> str:
    words = [f"{share:.1f}" for share in percent[: max(10, kept + 1)]]
    return " ".join([*words[:kept], *(["|"] if kept < len(words) else []), *words[kept:]])


def _draw(model: FaceModel, path: Path) -> None:
    from posetrack_cli.evaluation.viewing.face_picture import face_model_picture
    from posetrack_cli.evaluation.viewing.outputs import png_of
    from posetrack_cli.files import write_output
    from posetrack_cli.outputs import whole_or_nothing

    with whole_or_nothing(path) as part:
        write_output(part, png_of(face_model_picture(model)))


def _print_losses(faces: Sequence[ObservedFace]) -> None:
    from posetrack_cli.losses import loss_line

    lost = [face for face in faces if face.losses]
    for face in lost:
        print_note(f"{face.path}: {loss_line(tuple(face.losses))}")
    if lost:
        click.get_current_context().exit(EXIT_DATA_LOST)


@click.group()
def head() -> None:
    """Track a head, build face models, or generate recordings."""


head.add_command(head_build_model)
head.add_command(head_mono)
head.add_command(head_stereo)
head.add_command(head_synth)
