"""Print statistics of the code base: lines, comments, helpers called once, settings and options."""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click
from pydantic import BaseModel

ROOT = Path(__file__).parent.parent
LONGEST = 5
Function = ast.FunctionDef | ast.AsyncFunctionDef


def lines_of(sources: Mapping[Path, str]) -> dict[str, int]:
    """Count the lines of sources: all, blank, comments, docstrings, code."""
    lines = [line.strip() for text in sources.values() for line in text.splitlines()]
    found = {
        "lines": len(lines),
        "blank": lines.count(""),
        "comments": sum(one.startswith("#") for one in lines),
    }
    scopes = (node for text in sources.values() for node in ast.walk(ast.parse(text)))
    documented = (node for node in scopes if isinstance(node, Function | ast.ClassDef | ast.Module))
    found["docstrings"] = sum(
        (node.body[0].end_lineno or 0) - node.body[0].lineno + 1
        for node in documented
        if ast.get_docstring(node, clean=False) is not None
    )
    found["code"] = found["lines"] - found["blank"] - found["comments"] - found["docstrings"]
    return found


def functions_of(sources: Mapping[Path, str]) -> Iterator[tuple[Path, Function]]:
    """Yield all functions and methods with their files."""
    for path, text in sources.items():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, Function):
                yield path, node


def called_once(sources: Mapping[Path, str]) -> float:
    """Return the share of private functions that are called once."""
    # A name that occurs twice in its file is defined and called once.
    words = {path: Counter(re.findall(r"[A-Za-z_]\w*", text)) for path, text in sources.items()}
    private = [(path, f.name) for path, f in functions_of(sources) if re.match(r"_(?!_)", f.name)]
    return sum(words[path][name] == 2 for path, name in private) / max(len(private), 1)


def passed_on(function: Function) -> list[bool]:
    """Return for each parameter whether it is used only as an argument of calls."""
    names = [node for node in ast.walk(function) if isinstance(node, ast.Name)]
    calls = [node for node in ast.walk(function) if isinstance(node, ast.Call)]
    given = [one for call in calls for one in (*call.args, *(keyword.value for keyword in call.keywords))]
    direct = {id(one.value if isinstance(one, ast.Starred) else one) for one in given}
    arguments = function.args
    parameters = (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)
    found = []
    for parameter in (one.arg for one in parameters if one.arg not in ("self", "cls")):
        uses = [id(node) for node in names if node.id == parameter]
        found.append(bool(uses) and direct.issuperset(uses))
    return found


def settings_of(model: type[BaseModel]) -> int:
    """Return the number of settings of a configuration."""
    nested = (field.annotation for field in model.model_fields.values())
    return sum(settings_of(of) if isinstance(of, type) and issubclass(of, BaseModel) else 1 for of in nested)


def options_of(command: Any) -> Iterator[str]:
    """Yield the options of every command that is not a group."""
    for child in getattr(command, "commands", {}).values():
        yield from options_of(child)
        options = (one for one in child.params if isinstance(one, click.Option))
        yield from (option.opts[-1] for option in options if not hasattr(child, "commands"))


def main(folder: str = "posetrack_cli") -> None:
    """Print one line per figure."""
    sources = {path: path.read_text("utf-8") for path in sorted((ROOT / folder).rglob("*.py"))}
    lines, functions = lines_of(sources), list(functions_of(sources))
    print(f"{folder}: {len(sources)} files, " + ", ".join(f"{count} {name}" for name, count in lines.items()))
    shares = (f"{name} {100 * lines[name] / lines['lines']:.1f} %" for name in ("comments", "docstrings"))
    print(f"shares of lines: {', '.join(shares)}")
    print(f"private functions called once: {100 * called_once(sources):.0f} %")
    passing = [one for _, function in functions for one in passed_on(function)]
    print(f"pass-on parameters: {100 * sum(passing) / max(len(passing), 1):.0f} % of {len(passing)}")
    lengths = sorted(
        ((f.end_lineno or 0) - f.lineno + 1, str(path.relative_to(ROOT)), f.name) for path, f in functions
    )
    print(f"functions: {len(lengths)}, longest:")
    for length, path, name in reversed(lengths[-LONGEST:]):
        print(f"  {length} lines: {path}: {name}")
    if folder == "posetrack_cli":
        from posetrack_cli.cli.main import cli
        from posetrack_cli.hand.config import HandConfig
        from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig

        models: dict[str, type[BaseModel]] = {"hand": HandConfig, "head-mono": HeadMonoConfig}
        models["head-stereo"] = HeadStereoConfig
        counts = {name: settings_of(model) for name, model in models.items()}
        each = ", ".join(f"{name} {count}" for name, count in counts.items())
        print(f"settings: {sum(counts.values())}: {each}")
        options = list(options_of(cli))
        print(f"command-line options: {len(options)}, {len(set(options))} distinct")


if __name__ == "__main__":
    main(*sys.argv[1:])
