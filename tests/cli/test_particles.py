"""What ``--help`` says of the numbers of particles is what runs have."""

from __future__ import annotations

import re

import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig

STATED = re.compile(r"Number of particles\.\s+\[default:\s+([^\]]+)\]")
HAND = HandConfig()
DEFAULTS = {
    "hand run": f"{HAND.filter.particles}; {HAND.pso.particles} for pso",
    "head mono": str(HeadMonoConfig().particles.count),
    "head stereo": str(HeadStereoConfig().particles.count),
}


@pytest.mark.parametrize("before", [(), ("batch",)], ids=["alone", "batch"])
@pytest.mark.parametrize("command", DEFAULTS)
def test_help_states_how_many_particles_there_are(
    command: str, before: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([*before, *command.split(), "--help-all"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    stated = STATED.search(text)
    assert stated is not None
    assert stated[1] == DEFAULTS[command]
