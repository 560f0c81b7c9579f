"""Random single changes of the code: do the tests notice?

    python -m tests.fuzz.mutants --room filters [--count 20] [--seed 1] [--near]

Each change (another comparison, sign, number, argument order; a statement left out) is made in a
copy of the project, where tests run until the first one fails: those of that room, the ones that
import the changed module before all others, and tests of other rooms that import it, too. Words of
errors are not changed. Some of what no test notices changes nothing that matters, which only a
reader can see. Takes about a minute for each change of a kernel, as it has to be compiled. With
`--near` only tests that import the changed module run: quicker, and less may be noticed.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
COPIED = ("clt", "tests", "schemas", "sample_logs", "docs", "README.md", "pyproject.toml")
OPERATORS: dict[type[ast.AST], tuple[str, str]] = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Pow: ("**", "*"),
    ast.And: ("and", "or"),
    ast.Or: ("or", "and"),
}
"""What stands for an operator, and what it becomes."""
NAMES = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum"}
MAX_SLOWDOWN, MORE_S, NEAR_S = 4.0, 120, 600
"""Tests that take so much more processor time than without a change (`--near`: so many seconds)
have noticed it."""


class Change(NamedTuple):
    """One change of a file, as offsets of its text."""

    path: Path
    begin: int
    end: int
    text: str


def changes_of_file(path: Path) -> Iterator[Change]:
    """All single changes within the functions of a file."""
    source = path.read_text()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line.encode()))
    raw = source.encode()

    def offset(line: int, column: int) -> int:
        return len(raw[: starts[line - 1] + column].decode())

    def span(node: ast.expr | ast.stmt) -> tuple[int, int]:
        end = offset(node.end_lineno or node.lineno, node.end_col_offset or 0)
        return offset(node.lineno, node.col_offset), end

    for function in ast.walk(ast.parse(source)):
        if isinstance(function, ast.FunctionDef):
            body = function.body[1:] if ast.get_docstring(function) is not None else function.body
            for node in chain.from_iterable(map(nodes_to_change, body)):
                for begin, end, text in changes_of_node(node, span, source):
                    yield Change(path, begin, end, text)


def nodes_to_change(node: ast.AST) -> Iterator[ast.AST]:
    """A node and all below it, but for the words of errors, annotations and inner functions."""
    if isinstance(node, ast.Raise | ast.JoinedStr | ast.FunctionDef):
        return
    yield node
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and name != "annotation":
                yield from nodes_to_change(child)


def changes_of_node(node: ast.AST, span, source: str) -> Iterator[tuple[int, int, str]]:
    """Changes of one node: begin, end, new text."""
    if isinstance(node, ast.Compare):
        ends = [node.left, *node.comparators]
        for left, operator, right in zip(ends[:-1], node.ops, ends[1:], strict=True):
            yield from between(span(left)[1], span(right)[0], operator, source)
    elif isinstance(node, ast.BinOp):
        yield from between(span(node.left)[1], span(node.right)[0], node.op, source)
    elif isinstance(node, ast.BoolOp):
        for left, right in zip(node.values[:-1], node.values[1:], strict=True):
            yield from between(span(left)[1], span(right)[0], node.op, source)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield span(node)[0], span(node.operand)[0], ""
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
        value = node.value
        other = (
            not value if isinstance(value, bool) else value + 1 if value in {0, 1} else value * 2
        )
        yield *span(node), repr(other)
    elif isinstance(node, ast.Call) and len(node.args) > 1:
        (a, b), (c, d) = span(node.args[0]), span(node.args[1])
        if source[a:b] != source[c:d]:
            yield a, d, source[c:d] + source[b:c] + source[a:b]
    elif isinstance(node, ast.Name | ast.Attribute):
        name = node.id if isinstance(node, ast.Name) else node.attr
        if name in NAMES:
            yield span(node)[1] - len(name), span(node)[1], NAMES[name]
    elif isinstance(node, ast.AugAssign) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    ):
        yield *span(node), "pass"


def between(begin: int, end: int, operator: ast.AST, source: str) -> Iterator[tuple[int, int, str]]:
    """The change of an operator that stands between two operands."""
    old, new = OPERATORS.get(type(operator), ("", ""))
    pattern = rf"(?<!\w){re.escape(old)}(?!\w)" if old.isalpha() or " " in old else re.escape(old)
    found = re.search(pattern, source[begin:end]) if old != "" else None
    if found is not None:
        yield begin + found.start(), begin + found.end(), new


def describe(change: Change) -> str:
    """Where it is and what it makes of the line."""
    source = change.path.read_text()
    line = source.count("\n", 0, change.begin) + 1
    first = source.rfind("\n", 0, change.begin) + 1
    last = source.find("\n", change.end)
    after = source[first : change.begin] + change.text + source[change.end : last]
    return f"{change.path.relative_to(ROOT)}:{line}: {' '.join(after.split())}"


def run_tests(copy: Path, tests: list[str], limit: int | None) -> bool:
    """Whether all tests pass, within so many seconds of processor time."""
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    environment = os.environ | {"PYTHONPATH": str(copy), "HYPOTHESIS_STORAGE_DIRECTORY": str(copy)}

    def limited() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))

    done = subprocess.run(
        words, cwd=copy, env=environment, capture_output=True, check=False, preexec_fn=limited
    )
    return done.returncode == 0


def test_files(path: Path, room: str, near_only: bool) -> list[str]:
    """Files of tests: those that import a changed file by its name, then the others of its room."""
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    package, _, name = module.rpartition(".")
    named = re.compile(
        rf"(from|import) {re.escape(module)}\b|from {re.escape(package)} import .*\b{name}\b"
    )
    own, near, far = [], [], []
    for file in sorted((ROOT / "tests").rglob("test_*.py")):
        inside = file.is_relative_to(ROOT / "tests" / room)
        if named.search(file.read_text()):
            (own if inside else far).append(file)
        elif inside and not near_only:
            near.append(file)
    return [str(file.relative_to(ROOT)) for file in (*own, *near, *far)]


def time_limit(copy: Path, room: str) -> int:
    """Processor time, s, by what the tests of a room take without any change."""
    began = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    if not run_tests(copy, [f"tests/{room}"], None):
        sys.exit(f"the tests of {room} fail without any change")
    took = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - began
    return round(MAX_SLOWDOWN * took) + MORE_S


def main() -> None:
    """Try changes, print those that no test notices, and the share that was noticed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--room", required=True)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--near", action="store_true")
    options = parser.parse_args()
    files = sorted((ROOT / "clt" / options.room).rglob("*.py"))
    every = [change for file in files for change in changes_of_file(file)]
    chosen = random.Random(options.seed).sample(every, min(options.count, len(every)))
    survived = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "project"
        copy.mkdir()
        for name in COPIED:
            source = ROOT / name
            (shutil.copytree if source.is_dir() else shutil.copy2)(source, copy / name)
        limit = NEAR_S if options.near else time_limit(copy, options.room)
        for change in chosen:
            text = change.path.read_text()
            place = copy / change.path.relative_to(ROOT)
            place.write_text(text[: change.begin] + change.text + text[change.end :])
            tests = test_files(change.path, options.room, options.near)
            unseen = len(tests) == 0 or run_tests(copy, tests, limit)
            survived += unseen
            print(f"{'NOT noticed' if unseen else 'noticed'}: {describe(change)}", flush=True)
            shutil.copy2(change.path, place)
    noticed = len(chosen) - survived
    print(f"{options.room}: {noticed} of {len(chosen)} changes noticed, seed {options.seed}")


if __name__ == "__main__":
    main()
