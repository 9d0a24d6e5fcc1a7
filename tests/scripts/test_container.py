"""The container files agree with each other and with the checkout."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from container import instructions

ROOT = Path(__file__).parents[2]
DOCKERFILE = instructions((ROOT / "containers/Dockerfile").read_text())
DEFINITION = (ROOT / "containers/posetrack.def").read_text()


def given(name: str) -> list[str]:
    return [arguments for instruction, arguments in DOCKERFILE if instruction == name]


def test_both_images_are_made_of_the_same_systems_files_and_steps() -> None:
    bases = [one.split()[0] for one in given("FROM")]
    assert re.findall(r"^From: (\S+)$", DEFINITION, re.MULTILINE) == bases
    for words in map(str.split, given("COPY")):
        *sources, _ = (word for word in words if not word.startswith("--from"))
        for source in sources:
            assert re.search(rf"^    {re.escape(source)} /\S+$", DEFINITION, re.MULTILINE), source
            assert source.startswith("/") or (ROOT / source).exists()
    for command in given("RUN"):
        assert f"    {command}\n" in DEFINITION or command.startswith(
            "useradd"
        )  # Apptainer runs as the caller


def test_both_images_have_the_same_variables() -> None:
    (variables,), (cpu,) = given("ENV"), given("ARG")
    expected = variables.replace("$CPU", cpu.removeprefix("CPU="))
    exported = re.search(r"^%environment\n((?:    export .*\n)+)", DEFINITION, re.MULTILINE)
    assert exported is not None
    assert " ".join(exported[1].replace("export ", "").split()) == expected
    assert expected.split(maxsplit=1)[1] in DEFINITION.split("%environment")[0], (
        "kernels are compiled for them"
    )


def test_images_have_a_python_that_posetrack_supports() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    versions = {name.removeprefix("Programming Language :: Python :: ") for name in project["classifiers"]}
    for base in given("FROM"):
        assert re.split("[:-]", base)[1] in versions
