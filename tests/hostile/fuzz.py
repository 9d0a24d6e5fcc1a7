"""The endless search: cases with fresh seeds until the time is over; what fails is kept."""

from __future__ import annotations

import argparse
import json
import math
import random
import re
import shlex
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings

from hostile.case import Case, load, save
from hostile.corpus import every_case
from hostile.invariant import violations
from hostile.running import Harness, Outcome, Pool
from hostile.seeds import Seeds, make_seeds
from hostile.targets import TARGETS
from posetrack_cli.errors import DAMAGED_HERE

BATCH = 40
"""Cases of one target before it is the next one's turn."""
SHRINKING, SHRINKING_S = 60, 20.0
"""Further runs that a failure is made smaller with, and seconds."""


@dataclass
class Failure:
    """The smallest case of a class of failures, and how many there were.

    Attributes:
        case: the smallest so far.
        broken: what it breaks.
        outcome: of it.
        count: of all cases of the class.
    """

    case: Case
    broken: list[str]
    outcome: Outcome
    count: int = 1


@dataclass
class Tally:
    """What was tried and what failed."""

    tried: Counter[str] = field(default_factory=Counter)
    codes: Counter[str] = field(default_factory=Counter)
    failed: Counter[str] = field(default_factory=Counter)
    failures: dict[str, Failure] = field(default_factory=dict)

    def add(self, case: Case, outcome: Outcome, broken: list[str]) -> str:
        """Count a case; return the class of its failure, or ""."""
        self.tried[case.target] += 1
        self.codes[f"{case.target} {outcome.code}"] += 1
        if not broken:
            return ""
        self.failed[case.target] += 1
        name = failure_class(broken, outcome)
        known = self.failures.get(name)
        if known is None:
            self.failures[name] = Failure(case, broken, outcome)
        else:
            known.count += 1
            if case.size() < known.case.size():
                known.case, known.broken, known.outcome = case, broken, outcome
        return name


def failure_class(broken: list[str], outcome: Outcome) -> str:
    """Return what failures of one cause have in common: the last line of code, or the first thing broken."""
    text = outcome.error.decode("utf-8", "replace") + outcome.stacks
    places = re.findall(r'File "[^"]*?/(posetrack_cli/[^"]+)", line (\d+), in (\w+)', text)
    where = ":".join(places[-1]) if places and "Traceback" in text else ""
    if not where and outcome.stacks:
        where = ":".join(places[0]) if places else ""
    said = f"(?:internal error:|{DAMAGED_HERE}, found)"
    bug = re.search(said + r" (\S+?):? .* at (posetrack_cli/\S+:\d+);", text)
    if bug:
        return f"{bug.group(1)} {bug.group(2)}"
    error = re.findall(r"^(\w+(?:\.\w+)*(?:Error|Exception|Interrupt))\b", text, re.MULTILINE)
    what = error[-1] if error and where else re.sub(r"U\+\w+|[0-9.@]+|/\S+", "#", broken[0])[:90]
    return f"{what} {where}".strip()


def search(harness: Harness, seeds: Seeds, target: str, count: int, number: int, tally: Tally) -> None:
    """Try some cases of a target; a failure of a class not met before is made smaller."""
    state: dict[str, Any] = {"class": "", "left": SHRINKING, "until": 0.0}

    @seed(number)
    @settings(
        max_examples=count,
        database=None,
        deadline=None,
        phases=[Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
        verbosity=Verbosity.quiet,
        print_blob=False,
        report_multiple_bugs=False,
    )
    @given(TARGETS[target](seeds))
    def attempt(case: Case) -> None:
        if state["class"] and (state["left"] <= 0 or time.monotonic() > state["until"]):
            return
        known = set(tally.failures)
        outcome = harness.run(case)
        name = tally.add(case, outcome, violations(case, outcome))
        if state["class"]:
            state["left"] -= 1
        if name and (name == state["class"] or (not state["class"] and name not in known)):
            if not state["class"]:
                state.update({"class": name, "until": time.monotonic() + SHRINKING_S})
            raise AssertionError(name)

    try:
        attempt()
    except AssertionError:
        pass
    except KeyboardInterrupt:
        raise
    except Exception as error:  # hypothesis calls what ends early flaky
        if "laky" not in type(error).__name__ and "laky" not in str(error):
            raise


def attempt_corpus(pool: Pool, seeds: Seeds, tally: Tally, until: float) -> None:
    """Try all attacks that once worked, before others are looked for."""
    cases = every_case(seeds)
    while time.monotonic() < until and (some := list(islice(cases, BATCH))):
        for case, outcome in zip(some, pool.run(some), strict=True):
            tally.add(case, outcome, violations(case, outcome))


def run(options: argparse.Namespace) -> int:
    tally, began = Tally(), time.monotonic()
    minutes = options.minutes if options.minutes is not None else math.inf if options.cases else 1.0
    until = began + 60.0 * minutes
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        with Pool() as pool:
            seeds, harness = make_seeds(pool), pool.harnesses[0]
            if not options.target:
                attempt_corpus(pool, seeds, tally, until)
            for target, number in turns(options, tally):
                if time.monotonic() > until:
                    break
                search(harness, seeds, target, options.batch, number, tally)
                if not options.quiet:
                    minutes = (time.monotonic() - began) / 60.0
                    print(f"{minutes:6.1f} min  {line_of(tally)}", file=sys.stderr, flush=True)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
    finally:
        report(tally, options, (time.monotonic() - began) / 60.0)
    return 1 if tally.failures else 0


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def turns(options: argparse.Namespace, tally: Tally) -> Iterator[tuple[str, int]]:
    """Yield targets in turn, each until it had its cases, with a number for the batch of each turn."""
    chance = random.Random(options.seed)
    targets = options.target or list(TARGETS)
    while options.cases is None or any(tally.tried[target] < options.cases for target in targets):
        for target in targets:
            if options.cases is None or tally.tried[target] < options.cases:
                yield target, chance.randrange(2**60)


def line_of(tally: Tally) -> str:
    return f"{tally.tried.total()} cases tried, {tally.failed.total()} failed in {len(tally.failures)} ways"


def report(tally: Tally, options: argparse.Namespace, minutes: float) -> None:
    """Print what was tried and what failed, and keep it where it is asked for."""
    for target in ("corpus", *TARGETS):
        if tally.tried[target]:
            codes = {c.split()[1]: n for c, n in sorted(tally.codes.items()) if c.split()[0] == target}
            print(f"{target:16}{tally.tried[target]:7} tried {tally.failed[target]:5} failed, codes {codes}")
    for number, (name, failure) in enumerate(sorted(tally.failures.items(), key=lambda f: -f[1].count), 1):
        print(f"\n{number}. {name} ({failure.count} times)\n   {failure.case!r}")
        for broken in failure.broken:
            print(f"   {broken}")
        if options.keep is not None:
            folder = options.keep / f"{number:03d}-{re.sub(r'[^A-Za-z0-9]+', '-', name)[:60].strip('-')}"
            save(failure.case, folder, _told(failure))
            print(f"   kept: {folder}; scripts/fuzz --again {shlex.quote(str(folder))}")
    print(f"\n{line_of(tally)}, in {minutes:.1f} minutes, seed {options.seed}")
    if options.json is not None:
        about = {
            "tried": tally.tried,
            "failed": tally.failed,
            "codes": tally.codes,
            "classes": {name: f.count for name, f in tally.failures.items()},
            "minutes": minutes,
            "seed": options.seed,
        }
        options.json.write_text(json.dumps(about, indent=1) + "\n")


def _told(failure: Failure) -> dict[str, Any]:
    outcome = failure.outcome
    return {
        "broken": failure.broken,
        "count": failure.count,
        "code": outcome.code,
        "error": outcome.error.decode("utf-8", "backslashreplace")[-20_000:],
        "out": outcome.out.decode("utf-8", "backslashreplace")[-5_000:],
        "cpu_s": outcome.cpu_s,
        "peak_bytes": outcome.peak_bytes,
        "stacks": outcome.stacks[-20_000:],
    }


def again(folders: list[Path]) -> int:
    """Run cases that were kept; print what becomes of them."""
    failed = 0
    with Harness() as harness:
        for folder in folders:
            case = load(folder)
            outcome = harness.run(case)
            broken = violations(case, outcome)
            failed += bool(broken)
            print(f"{folder.name}: exit code {outcome.code}, {'; '.join(broken) or 'as it must be'}")
            print(
                "   "
                + outcome.error.decode("utf-8", "backslashreplace").strip()[-3000:].replace("\n", "\n   ")
            )
    return 1 if failed else 0


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="scripts/fuzz", description="Search for inputs that break the invariant."
    )
    parser.add_argument(
        "--minutes", type=float, help="how long, by default 1 or as --cases takes; the seeds take one more"
    )
    parser.add_argument("--cases", type=int, metavar="N", help="stop after N cases of each target")
    parser.add_argument("--target", action="append", choices=list(TARGETS), help="only this one; repeatable")
    parser.add_argument(
        "--seed", type=int, default=None, help="of the search; by default a fresh one, which is told"
    )
    parser.add_argument("--batch", type=int, default=BATCH, help="cases of one target at a time")
    parser.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="keep the smallest case of each way to fail"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the counts")
    parser.add_argument(
        "--again", type=Path, nargs="+", metavar="FOLDER", help="only run cases that were kept"
    )
    parser.add_argument("--quiet", action="store_true", help="print nothing but the end")
    options = parser.parse_args()
    if options.again:
        return again(options.again)
    if options.seed is None:
        options.seed = random.SystemRandom().randrange(2**32)
    return run(options)


if __name__ == "__main__":
    sys.exit(main())
