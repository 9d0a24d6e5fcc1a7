"""What configurations and options name is what is registered."""

from __future__ import annotations

from typing import get_args

import click
import pytest

from posetrack_cli.cli.hand import hand_run
from posetrack_cli.filtering.filters import FILTERS
from posetrack_cli.filtering.resampling import resampling_schemes
from posetrack_cli.hand.config import FilterSettings
from posetrack_cli.hand.fit.likelihood import PROPOSALS

NAMES = {
    "kind": ("filter_kind", {*FILTERS, "pso"}),
    "proposal": ("proposal", {*PROPOSALS}),
    "resampling": ("resampling", {*resampling_schemes()}),
}


@pytest.mark.parametrize("key", NAMES)
def test_every_registered_name_can_be_configured_and_chosen(key: str) -> None:
    option, registered = NAMES[key]
    assert set(get_args(FilterSettings.model_fields[key].annotation)) == registered
    chosen = next(each for each in hand_run.params if each.name == option)
    assert isinstance(chosen.type, click.Choice)
    assert set(chosen.type.choices) == registered
