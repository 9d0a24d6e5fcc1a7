"""Builds the packages and uses each as a newcomer would: installed alone, from a folder of his own.

``scripts/check-packages`` calls this. What is typed are the ``bash`` blocks of README, which tests of the
documentation run, too; here nothing of the checkout is on the path.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import click

ROOT = Path(__file__).resolve().parents[1]
if __name__ == "__main__":
    sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from support.markdown import blocks  # type: ignore[import-not-found]  # noqa: E402

FRAMES = 12  # of each recording
KINDS = {"wheel": "*.whl", "sdist": "*.tar.gz"}
FACE = """
import av, cv2, sys
from pathlib import Path
with av.open(sys.argv[2], "w") as video:
    stream = video.add_stream("libx264", rate=30)
    images = [cv2.imread(str(path)) for path in sorted(Path(sys.argv[1]).rglob("*.png"))]
    stream.height, stream.width = images[0].shape[:2]
    for image in images:
        video.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
    video.mux(stream.encode(None))
"""
"""Makes a video of images, with what posetrack installs."""
WHERE = "import posetrack_cli; print(posetrack_cli.__file__)"


class Environment:
    """A virtual environment with nothing but a package and what it needs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        _run([sys.executable, "-m", "venv", str(folder)], ROOT)

    @property
    def variables(self) -> dict[str, str]:
        """What processes in it see: neither the checkout nor another environment."""
        kept = {
            key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))
        }
        return kept | {"PATH": f"{self.folder / 'bin'}{os.pathsep}{kept['PATH']}"}

    def install(self, *what: str) -> None:
        """Install what the checkout has locked, and then these, for which nothing else is looked up."""
        line = [str(self.folder / "bin" / "python"), "-m", "pip", "install", "--quiet", "--no-compile"]
        line += ["--disable-pip-version-check", "--no-deps"]
        _run([*line, "--require-hashes", "--requirement", "requirements.txt"], ROOT)
        if what:
            _run([*line, "--no-build-isolation", *what], ROOT)
            _run([str(self.folder / "bin" / "python"), "-m", "pip", "check"], ROOT)

    def run(self, command: list[str], folder: Path) -> str:
        """Run a command in a folder, and return what it prints."""
        return _run(command, folder, self.variables)

    def mebibytes(self) -> float:
        """What the installed modules take, without pip and what Python compiles of them as they are used."""
        (packages,) = self.folder.glob("lib/python*/site-packages")
        files = (path for path in packages.rglob("*") if path.is_file() and not path.is_symlink())
        own = (path for path in files if "pip" not in path.relative_to(packages).parts[0])
        return sum(path.stat().st_size for path in own if path.suffix != ".pyc") / 2**20


def _run(command: list[str], folder: Path, variables: dict[str, str] | None = None) -> str:
    ran = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True)
    if ran.returncode:
        raise click.ClickException(
            f"{' '.join(command)}: exit code {ran.returncode}\n{ran.stdout}{ran.stderr}"
        )
    return ran.stdout


def build(folder: Path) -> Path:
    """Build both packages, and return the folder that they are in."""
    maker = Environment(folder / "maker")
    maker.install()
    out = folder / "dist"
    maker.run(["hatchling", "build", "-d", str(out), "-t", "sdist", "-t", "wheel"], ROOT)
    return out


def recipes() -> Iterator[str]:
    """Yield what README says to type."""
    for block in blocks(ROOT / "README.md"):
        if block.language == "bash" and block.reason is None:
            yield block.text


def check(package: Path, folder: Path) -> str:
    """Install a package and type the recipes; return what came of it."""
    folder.mkdir()
    environment = Environment(folder / "venv")
    environment.install(str(package))
    size = environment.mebibytes()
    place = folder / "newcomer"
    place.mkdir()
    imported = Path(environment.run(["python", "-c", WHERE], place).strip())
    if not imported.is_relative_to(environment.folder.resolve()):
        raise click.ClickException(f"{package.name}: imported from {imported}")
    many = ["--frames", str(FRAMES), "--seed", "1"]
    environment.run(["posetrack", "hand", "synth", *many, "-o", "depth.mcap"], place)
    still = ["--camera-count", "1", "--motion", "slight", "--light", "steady", "--image-format", "png"]
    environment.run(["posetrack", "head", "synth", *many, *still, "-o", "made"], place)
    environment.run(["python", "-c", FACE, "made", "face.mp4"], place)
    began_s, typed = time.monotonic(), 0
    for recipe in recipes():
        environment.run(["bash", "-euo", "pipefail", "-c", recipe], place)
        typed += 1
    seconds = time.monotonic() - began_s
    return f"{package.name}: {size:.0f} MiB installed, {typed} recipes in {seconds:.0f} s"


@click.command()
@click.argument("kinds", nargs=-1, type=click.Choice(list(KINDS)))
def main(kinds: tuple[str, ...]) -> None:
    """Check wheel and sdist, or one of them."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        built = build(folder)
        for kind in kinds or KINDS:
            (package,) = built.glob(KINDS[kind])
            click.echo(check(package, folder / kind))


if __name__ == "__main__":
    main()
