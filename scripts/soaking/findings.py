"""What was found: figures, what they are held against, and what is not as it must be."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict

from benchmarking.rows import Row
from posetrack_cli.cli.terminal import print_note


class Findings:
    """Figures and troubles, printed as they come: figures on standard output, troubles on standard error."""

    def __init__(self) -> None:
        self.rows: list[Row] = []
        self.troubles: list[str] = []

    def add(self, row: Row) -> None:
        """Note a figure; one beyond what it may be is a trouble."""
        self.rows.append(row)
        print(row.line, flush=True)
        if row.verdict == "MISSED":
            unit = f" {row.unit}" if row.unit else ""
            self.trouble(f"{row.name}: {row.value:.4g}{unit}, at most {row.target:g}{unit}")

    def trouble(self, line: str) -> None:
        """Note what is not as it must be, in one line."""
        self.troubles.append(line)
        print_note(f"soak: {line}")

    def troubles_of(self, name: str, lines: Iterable[str]) -> bool:
        """Note troubles of one run; return whether there was none."""
        told = [f"{name}: {line}" for line in lines]
        for line in told:
            self.trouble(line)
        return not told

    def as_json(self, machine: Mapping[str, str]) -> str:
        """Everything, as scripts/bench writes it, with the troubles."""
        table = [asdict(row) | {"verdict": row.verdict} for row in self.rows]
        found = {"machine": dict(machine), "rows": table, "troubles": self.troubles}
        return json.dumps(found, indent=1) + "\n"

    def as_markdown(self, machine: Mapping[str, str]) -> str:
        """The tables of docs/robustness.md: the machine, then every figure."""
        lines = ["| machine | |", "|---|---|", *(f"| {key} | {value} |" for key, value in machine.items())]
        lines += ["", "| what | figure | at most |", "|---|---:|---:|"]
        for row in self.rows:
            most = "" if row.target is None else f"{row.target:g}"
            missed = " **MISSED**" if row.verdict == "MISSED" else ""
            figure = f"{row.value:,.2f}".removesuffix(".00")
            lines.append(f"| {row.name} | {figure} {row.unit}".rstrip() + f"{missed} | {most} |")
        return "\n".join(lines) + "\n"
