"""What counts of a written file, and that every command and option is among the steps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import click
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from digesting.contents import RUN_RECORD, digests_of
from digesting.steps import Step, command, groups
from digesting.workplace import Workplace, differences
from posetrack_cli.cli.main import cli

ROOT = Path(__file__).parents[2]
NOT_RUN = {
    "--help": "prints only",
    "--quiet": "prints less on standard error",
    "--verbose": "prints more on standard error",
    "--timings": "bytes differ from run to run",
    "--scheduler": "needs a cluster; the bytes are those of --jobs",
    "--scheduler-file": "needs a cluster; the bytes are those of --jobs",
    "--detector-model": "needs a model that is not shipped",
    "--dashboard": "opens a port; the bytes are those of --jobs",
    "--remote": "needs a server; tests/batch/test_remote.py compares the result with that of a local file",
    "--methods": "states the version, which differs by design",
}
"""Options that no step has, and why."""
MACHINE = {"doctor": "reports the machine"}
"""Commands that no step has, and why."""


def test_two_runs_agree(tmp_path: Path) -> None:
    steps = [
        command("made", "hand synth --frames 2 --seed 3 -o hand.mcap"),
        command("told", "info {made} --json -", printed=True),
    ]
    runs = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        workplace = Workplace(tmp_path / name, ROOT)
        runs.append({step.name: workplace.digest(step) for step in steps})
    assert list(differences(*runs)) == []
    assert runs[0]["told"].keys() == {"exit code", "standard output"}
    assert "hand.mcap /camera/depth/image" in runs[0]["made"]
    plant(tmp_path / "second" / "hand.mcap", "/truth/hand/odometry")
    now = {"made": {f"hand.mcap {k}": v for k, v in digests_of(tmp_path / "second" / "hand.mcap").items()}}
    changed = [line.split(": ")[1] for line in differences(runs[0], now)]
    assert changed == ["exit code", "hand.mcap /truth/hand/odometry"]


def plant(path: Path, topic: str) -> None:
    """Change one byte of the last message of a topic."""
    with path.open("rb") as stream:
        reader = make_reader(stream)
        messages = list(reader.iter_messages(log_time_order=False))
        records = list(reader.iter_metadata())
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    last = max(k for k, (_, channel, _) in enumerate(messages) if channel.topic == topic)
    with path.open("wb") as out:
        writer = Writer(out)
        writer.start()
        for k, (schema, channel, message) in enumerate(messages):
            assert schema is not None
            if schema.name not in schemas:
                schemas[schema.name] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.topic not in channels:
                how = channel.message_encoding, schemas[schema.name], channel.metadata
                channels[channel.topic] = writer.register_channel(channel.topic, *how)
            data = bytearray(message.data)
            data[-1] ^= k == last
            times = message.log_time, bytes(data), message.publish_time, message.sequence
            writer.add_message(channels[channel.topic], *times)
        for record in records:
            writer.add_metadata(record.name, record.metadata)
        writer.finish()


def write_result(path: Path, run: Mapping[str, str], model: bytes = b"learnt", frames: str = "2") -> Path:
    with path.open("wb") as out:
        writer = Writer(out)
        writer.start()
        schema = writer.register_schema("posetrack.Estimate", "jsonschema", b"{}")
        channel = writer.register_channel("/hand/estimate", "json", schema)
        for stamp in (1, 2):
            writer.add_message(channel, stamp, b'{"x": 1.0}', stamp)
        writer.add_metadata(RUN_RECORD, dict(run))
        writer.add_metadata("posetrack.summary", {"frames": frames})
        writer.add_metadata("posetrack.synth", {"version": run["version"], "input.sha256": run["version"]})
        writer.add_attachment(0, 0, "model.npz", "application/x-npz", model)
        writer.finish()
    return path


def test_run_record_and_version_do_not_count_in_a_result(tmp_path: Path) -> None:
    first = digests_of(write_result(tmp_path / "a.mcap", {"version": "1.0", "configuration": '{"a": 1}'}))
    again = digests_of(write_result(tmp_path / "b.mcap", {"version": "2.0", "configuration": '{"b": 2}'}))
    assert again == first
    assert set(first) == {
        *("/hand/estimate", "order of topics", "metadata posetrack.summary", "metadata posetrack.synth"),
        "attachment model.npz",
    }


def test_all_else_in_a_result_counts(tmp_path: Path) -> None:
    run = {"version": "1.0"}
    first = digests_of(write_result(tmp_path / "a.mcap", run))
    now = digests_of(write_result(tmp_path / "b.mcap", run, b"learned", "3"))
    assert [key for key in first if first[key] != now[key]] == [
        *("metadata posetrack.summary", "attachment model.npz")
    ]


PAGE = '<p>{figure}</p><table class="record"><td>{key}</td></table><li>Written by posetrack {version}.</li>'
REPORT = (
    '{{"version": "{version}", "peak_bytes": {key}, "results": [{{"x": {figure}, "run": {{"k": "{key}"}}}}]}}'
)
TABLE = "# run: {{{key} {version}}}\n# mm\nx\n{figure}\n"
WRITTEN = [("a.html", PAGE), ("a.json", REPORT), ("a.csv", TABLE)]


@pytest.mark.parametrize(("name", "text"), WRITTEN)
def test_figures_of_a_report_count_and_its_run_does_not(tmp_path: Path, name: str, text: str) -> None:
    def digests(**values: str) -> dict[str, str]:
        (tmp_path / name).write_text(text.format(**values))
        return digests_of(tmp_path / name)

    first = digests(figure="1.5", key="1", version="1.0.0")
    assert digests(figure="1.5", key="2", version="2.0.0") == first
    assert digests(figure="1.6", key="1", version="1.0.0") != first


def leaves(group: click.Command, path: tuple[str, ...] = ()) -> Iterator[tuple[str, click.Command]]:
    if not isinstance(group, click.Group):
        yield " ".join(path), group
        return
    context = click.Context(group)
    for name in group.list_commands(context):
        found = group.get_command(context, name)
        assert found is not None
        yield from leaves(found, (*path, name))


COMMANDS = dict(leaves(cli))
STEPS = [step for group in groups().values() for step in group]


def command_of(step: Step) -> str:
    return next(" ".join(step.arguments[:n]) for n in (3, 2, 1) if " ".join(step.arguments[:n]) in COMMANDS)


def options_of(name: str) -> dict[str, frozenset[str]]:
    """The options of a command by their first long name, with all their names."""
    options = (p for p in COMMANDS[name].params if isinstance(p, click.Option) and not p.hidden)
    return {max(p.opts, key=len): frozenset((*p.opts, *p.secondary_opts)) for p in options}


def test_every_command_is_a_step() -> None:
    done = {command_of(step) for step in STEPS if step.arguments}
    assert COMMANDS.keys() - done == MACHINE.keys()


@pytest.mark.parametrize("name", sorted(COMMANDS.keys() - MACHINE.keys()))
def test_every_option_is_in_a_step(name: str) -> None:
    steps = [step for step in STEPS if step.arguments and command_of(step) == name]
    used = {text for step in steps for text in step.arguments} | {
        "--resume" for step in steps if step.interrupted
    }
    options = options_of(name)
    known = {option for names in options.values() for option in names}
    assert {text for text in used if text.startswith("--")} <= known | {"--resume"}
    handed_on = set[str]()
    if name.startswith("batch "):  # its own options mean the same for all trackers
        handed_on |= options_of(name.removeprefix("batch ")).keys()
        used |= {text for step in STEPS if step.arguments[:1] == ("batch",) for text in step.arguments}
    missing = {
        o for o, names in options.items() if not names & used and o not in NOT_RUN and o not in handed_on
    }
    assert missing == set(), "add a step to scripts/digesting/steps.py, or a reason to NOT_RUN"
