"""Commands on several logs: one process for many, in the order of the arguments.

A command is written for one `log`; `for_many_logs` makes it one for `logs`, with `--jobs`. A log
that fails does not stop the others.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from clt.cli.options import JobsOption

if TYPE_CHECKING:
    from clt.cli.console import Console

Item = TypeVar("Item")
Value = TypeVar("Value")

MANY_LOGS_HELP = (
    "Logs: MCAP, .db3 or folders of ROS 2 bags; `-` is standard input. Of several, -o names a "
    "folder, which is made if it is missing."
)
LogsArgument = Annotated[list[Path], typer.Argument(help=MANY_LOGS_HELP, metavar="LOG...")]


@dataclass(frozen=True)
class LogCall:
    """A command on one of several logs."""

    place: str
    """`module:function`."""
    log: Path
    output: Path | None
    options: dict[str, Any]
    words: tuple[str, ...]
    """The command line that does the same alone."""


@dataclass(frozen=True)
class LogDone:
    """What came of it."""

    code: int
    stdout: str
    stderr: str


def for_many_logs(function: Callable[..., int], place: str, suffix: str) -> Callable[..., int]:
    """A command of one `log` as one of several, whose results get the `suffix` in a folder."""

    def run(*, logs: list[Path], jobs: int = 1, **options: Any) -> int:
        if len(logs) == 1:
            return function(log=logs[0], **options)
        return run_each(place, logs, jobs, options, suffix)

    signature = inspect.signature(function, eval_str=True)
    taken = [one.replace(kind=one.KEYWORD_ONLY) for one in signature.parameters.values()]
    several = inspect.Parameter("logs", inspect.Parameter.KEYWORD_ONLY, annotation=LogsArgument)
    count = inspect.Parameter(
        "jobs", inspect.Parameter.KEYWORD_ONLY, annotation=JobsOption, default=1
    )
    shown = [several if one.name == "log" else one for one in taken]
    at = next(k for k, one in enumerate(shown) if one.name == "force")
    shown.insert(at, count)
    run.__signature__ = signature.replace(parameters=shown)  # type: ignore[attr-defined]
    run.__annotations__ = {one.name: one.annotation for one in shown} | {"return": int}
    run.__doc__ = function.__doc__
    run.__name__ = function.__name__
    return run


def run_each(place: str, logs: list[Path], jobs: int, options: dict[str, Any], suffix: str) -> int:
    """Run a command on every log; print what each says as if it had run alone."""
    import json
    import sys

    from clt.cli.console import Console
    from clt.core.diagnostics import Diagnostic

    console = Console(bool(options.get("quiet")), bool(options.get("verbose")))
    outputs = output_paths(logs, options.pop("output", None), suffix)
    calls = [
        LogCall(place, log, output, options, words_of_one(sys.argv[1:], logs, log))
        for log, output in zip(logs, outputs, strict=True)
    ]
    done: list[LogDone] = []
    documents: list[Any] = []
    results = in_order(run_call, calls, jobs, console, lost_call)
    for call, found in zip(calls, results, strict=True):
        done.append(found)
        console.progress("")
        sys.stderr.write(found.stderr)
        if options.get("as_json"):
            documents += [{"log": str(call.log), **json.loads(found.stdout)}]
        elif found.stdout != "":
            print(f"{call.log}:\n{found.stdout}", end="")
    if options.get("as_json"):
        print(json.dumps(documents, allow_nan=False))
    for call, found in zip(calls, done, strict=True):
        if is_failure(found.code):
            error = f"{call.log}: exit code {found.code}: {last_line(found.stderr)}"
            console.report([Diagnostic("log_failed", str(call.log), "partial", {"error": error})])
    return common_code([one.code for one in done])


def in_order(
    function: Callable[[Item], Value],
    items: Sequence[Item],
    jobs: int,
    console: Console,
    lost: Callable[[Item, str], Value],
) -> Iterator[Value]:
    """What comes of every item, in the order of the items, each as soon as it can be.

    `lost` makes the result of one whose worker died.
    """
    if jobs == 1 or len(items) == 1:
        for number, item in enumerate(items):
            if number > 0:
                console.progress(f"{number} of {len(items)} logs")
            yield function(item)
        return
    from functools import partial

    from clt.studies.executors import WorkerLost
    from clt.studies.executors.local import run_local

    tasks = list(enumerate(items))
    executed = run_local(partial(on_second, function), tasks, jobs)
    early: dict[int, Value] = {}
    following = 0
    for (number, item), found in executed:
        early[number] = lost(item, found.text) if isinstance(found, WorkerLost) else found
        while following in early:
            yield early.pop(following)
            following += 1
        console.progress(f"{following + len(early)} of {len(items)} logs")
    console.progress("")


def on_second(function: Callable[[Item], Value], task: tuple[int, Item]) -> Value:
    """The function of an item that has a number."""
    return function(task[1])


def run_call(call: LogCall) -> LogDone:
    """Run one call and catch all that it prints."""
    import io
    from contextlib import redirect_stderr, redirect_stdout

    from clt.cli.app import guard
    from clt.cli.lazy import CommandEntry, load_command
    from clt.cli.provenance import record_as_command

    out, err = io.StringIO(), io.StringIO()
    named = {} if call.output is None else {"output": call.output}
    command = guard(load_command(CommandEntry(call.place, "")))
    code = 1
    with redirect_stdout(out), redirect_stderr(err), record_as_command(call.words):
        try:
            command(log=call.log, **named, **call.options)
        except typer.Exit as end:
            code = end.exit_code
    return LogDone(code, out.getvalue(), err.getvalue())


def lost_call(_: LogCall, text: str) -> LogDone:
    """A command whose worker died."""
    return LogDone(1, json_of_error(text), f"clt: error: {text}\n")


def json_of_error(text: str) -> str:
    """What a failed command prints with `--json`."""
    import json

    return json.dumps({"error": text, "exit_code": 1})


def output_paths(logs: Sequence[Path], folder: Path | None, suffix: str) -> list[Path | None]:
    """Where the result of each log goes: names of logs, with their folders where these collide.

    Raises UsageError for a log that is given twice, standard input or output, no folder.
    """
    from clt.core.errors import UsageError

    places = [log.resolve() for log in logs]
    for k, place in enumerate(places):
        if str(logs[k]) == "-":
            raise UsageError("of several logs none can be standard input")
        if place in places[:k]:
            raise UsageError(f"{logs[k]}: given twice")
    if folder is None:
        return [None] * len(logs)
    meant = folder.is_dir() or (folder.suffix == "" and not folder.exists())
    if str(folder) == "-" or not meant:
        raise UsageError(f"-o {folder}: results of several logs need a folder")
    folder.mkdir(parents=True, exist_ok=True)
    names = distinct_names(places)
    return [folder / f"{name}{suffix}" for name in names]


def distinct_names(places: Sequence[Path]) -> list[str]:
    """The name of each path without its suffix, behind as many of its folders as it takes."""
    stems = [place.name if place.is_dir() else place.stem for place in places]
    folders = [place.parent.parts[1:] for place in places]
    names = list(stems)
    depth = 1
    while len({name.casefold() for name in names}) < len(names):
        if depth > max(len(parts) for parts in folders):
            return [f"{k + 1}_{stem}" for k, stem in enumerate(stems)]
        folded = [name.casefold() for name in names]
        for k, parts in enumerate(folders):
            if folded.count(folded[k]) > 1:
                names[k] = "_".join([*parts[-depth:], stems[k]])
        depth += 1
    return names


def words_of_one(words: Sequence[str], logs: Sequence[Path], log: Path) -> tuple[str, ...]:
    """A command line with one of its logs, without `--jobs`."""
    others = {str(other) for other in logs} - {str(log)}
    kept: list[str] = []
    for before, word in zip(["", *words], words, strict=False):
        if word not in others and "--jobs" not in {word.partition("=")[0], before}:
            kept.append(word)
    return tuple(kept)


def is_failure(code: int) -> bool:
    """Neither done nor done in part."""
    return code not in {0, 3}


def common_code(codes: Sequence[int]) -> int:
    """3 where something is missing of some log; where all failed, how."""
    if all(map(is_failure, codes)):
        return codes[0] if len(set(codes)) == 1 else 1
    return 0 if all(code == 0 for code in codes) else 3


def last_line(text: str) -> str:
    """The last line of what a command said, which is its error."""
    lines = [line for line in text.splitlines() if line.strip() != ""]
    return lines[-1].removeprefix("clt: ").removeprefix("error: ") if len(lines) > 0 else ""
