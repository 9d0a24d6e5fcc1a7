"""Execute the steps of ``containers/Dockerfile`` in a chroot, and use the image as its own user.

Every stage is a chroot: a temporary file system with this machine's system folders, and empty folders that
the steps fill. Stages need Python 3.11, pip, git and OpenGL from the system. Call it in a mount namespace of
its own (``scripts/check-container``).
"""

from __future__ import annotations

import json
import re
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCKERFILE = ROOT / "containers" / "Dockerfile"
SYSTEM = ("bin", "dev", "lib", "lib64", "proc", "root", "sbin", "sys", "usr", "var")  # from this machine
COPIED = ("etc",)  # steps add users
IMAGE_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
FIRST_FRAME_CPU_S = 3.0


@dataclass
class Stage:
    """A stage of the image being built.

    Attributes:
        root: its file system.
        environment: variables of ENV and ARG.
        user, folder: set by USER and WORKDIR.
        entrypoint: set by ENTRYPOINT.
    """

    root: Path
    environment: dict[str, str] = field(default_factory=lambda: {"PATH": IMAGE_PATH})
    user: str = "root"
    folder: str = "/"
    entrypoint: list[str] = field(default_factory=list)

    def run(self, command: list[str], **more: str) -> None:
        """Run a command in the chroot as the stage's user."""
        home = "/root" if self.user == "root" else f"/home/{self.user}"
        environment = {**self.environment, "HOME": home, **more}
        jail = ["chroot", f"--userspec={self.user}", str(self.root), "/usr/bin/env", f"--chdir={self.folder}"]
        subprocess.run([*jail, *command], env=environment, check=True)


def instructions(text: str) -> list[tuple[str, str]]:
    """Return the instructions of a Dockerfile as name and arguments."""
    lines = (line.strip() for line in text.replace("\\\n", " ").splitlines())
    return [tuple(line.split(maxsplit=1)) for line in lines if line and not line.startswith("#")]  # type: ignore[misc]


def make_root(folder: Path) -> Path:
    """Return a new root file system with this machine's system folders."""
    folder.mkdir()
    for name in SYSTEM:
        source, target = Path("/") / name, folder / name
        if source.is_symlink():
            target.symlink_to(source.readlink())
        elif source.is_dir():
            target.mkdir()
            subprocess.run(["mount", "--rbind", str(source), str(target)], check=True)
    for name in COPIED:
        shutil.copytree(Path("/") / name, folder / name, symlinks=True)
    for name in ("home", "opt", "tmp"):
        (folder / name).mkdir()
    (folder / "tmp").chmod(0o1777)
    return folder


def build(text: str, folder: Path) -> Stage:
    """Execute the instructions; return the last stage."""
    stages: dict[str, Stage] = {}
    stage = Stage(Path())
    for name, arguments in instructions(text):
        print(f"{name} {arguments}", flush=True)
        if name == "FROM":
            _, *alias = re.split(r"\s+AS\s+", arguments)
            stage = Stage(make_root(folder / f"stage-{len(stages)}"))
            stages[alias[0] if alias else ""] = stage
        elif name == "COPY":
            copy(stages, stage, arguments.split())
        else:
            execute(stage, name, arguments)
    return stage


def execute(stage: Stage, name: str, arguments: str) -> None:
    """Execute an instruction that concerns one stage."""
    if name in ("ARG", "ENV"):
        for one in shlex.split(arguments):
            key, _, value = one.partition("=")
            stage.environment[key] = re.sub(r"\$(\w+)", lambda m: stage.environment[m[1]], value)
    elif name == "RUN":
        stage.run(["sh", "-c", arguments])
    elif name == "USER":
        stage.user = arguments
    elif name == "WORKDIR":
        stage.folder = arguments
        (stage.root / arguments.lstrip("/")).mkdir(parents=True, exist_ok=True)
    elif name == "ENTRYPOINT":
        stage.entrypoint = json.loads(arguments)
    elif name != "CMD":
        sys.exit(f"container: unknown instruction {name}")


def copy(stages: dict[str, Stage], stage: Stage, words: list[str]) -> None:
    """Copy files of the checkout, or of another stage, into a stage."""
    origin = ROOT
    if words[0].startswith("--from="):
        origin = stages[words.pop(0).removeprefix("--from=")].root
    *sources, target = words
    place = stage.root / target.lstrip("/")
    for source in sources:
        path = origin / source.lstrip("/")
        if source == ".":  # what is committed, as .dockerignore leaves out what is not
            subprocess.run(["git", "clone", "--quiet", str(ROOT), str(place)], check=True)
        elif path.is_dir():
            shutil.copytree(path, place)
        else:
            place.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, place)


def main() -> None:
    """Build, then track a recording in the image; print sizes and the CPU time up to the first frame."""
    with tempfile.TemporaryDirectory(prefix="container-") as scratch:
        folder = Path(scratch)
        subprocess.run(["mount", "-t", "tmpfs", "none", scratch], check=True)
        try:
            image = build(DOCKERFILE.read_text(encoding="utf-8"), folder)
            use(image)
        finally:
            subprocess.run(["umount", "--lazy", "--recursive", scratch], check=False)


def use(image: Stage) -> None:
    """Run commands as the image's user and as a user that the image does not know."""
    posetrack = image.entrypoint
    image.run([*posetrack, "hand", "synth", "--frames", "5", "-o", "/tmp/hand.mcap"])
    given = ["--hand-side", "right", "--shape", "average", "--end", "1"]
    for user in (image.user, "12345:12345"):
        image.user = user
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        image.run(
            [*posetrack, "hand", "run", "/tmp/hand.mcap", *given, "-o", f"/tmp/{user[:5]}.mcap"], HOME="/tmp"
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        print(f"user {user}: one frame in {cpu_s:.1f} s of CPU time")
        if cpu_s > FIRST_FRAME_CPU_S:
            sys.exit(f"container: the first frame took more than {FIRST_FRAME_CPU_S:g} s of CPU time")
    image.run([*posetrack, "doctor", "--device", "cpu"])


if __name__ == "__main__":
    main()
