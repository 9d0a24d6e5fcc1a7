from __future__ import annotations

from typing import Any

import pytest

from posetrack_cli.errors import UsageError
from posetrack_cli.synthesis.hand.options import SWITCH_NAMES, Switches, SynthOptions


@pytest.mark.parametrize(
    "bad",
    [
        {"motion": "D"},
        {"side": "both"},
        {"frames": 0},
        {"seed": -1},
        {"frames": 10**12},
        {"speed": 0.0},
        {"speed": 1e300},
        {"speed": -1.0},
        {"speed": float("nan")},
        {"fps": 0.0},
        {"fps": float("inf")},
        {"scale": 0.0},
        {"scale": 3.0},
    ],
)
def test_bad_options_are_wrong_usage(bad: dict[str, Any]) -> None:
    (name,) = bad
    with pytest.raises(UsageError, match=f"invalid --{name}"):
        SynthOptions(**bad)


def test_everything_is_on_for_c_and_off_for_the_walks() -> None:
    for name in SWITCH_NAMES:
        assert getattr(Switches.usual("C"), name)
        assert not getattr(Switches.usual("A"), name) and not getattr(Switches.usual("B"), name)
