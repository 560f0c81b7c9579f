"""`clt compare`: several filters and settings on one log, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clt.cli.common import read_for_estimate, require_data
from clt.cli.options import (
    CalibrationOption,
    ForceOption,
    JsonOption,
    LogArgument,
    QuietOption,
    StreamsOption,
    VerboseOption,
)
from clt.cli.period import FromOption, ToOption

if TYPE_CHECKING:
    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.core.recording import Recording
    from clt.studies.comparison import Compared
    from clt.studies.document import RunTable

TABLE_SUFFIX, PICTURE_SUFFIXES = ".csv", (".png", ".svg", ".pdf")


def compare(
    *,
    log: LogArgument,
    filters: Annotated[
        str | None, typer.Option(metavar="F,F,...", help="Filters, e.g. eskf,ukf,mixture.")
    ] = None,
    runs: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=OPTIONS",
            help="A run by name with options of `clt localize`: --filter, --frame, --init, "
            '--engine, --config, --set, --as-received; e.g. "wide=--filter ukf --set gate=5". '
            "May be repeated.",
        ),
    ] = [],  # noqa: B006 - typer copies it
    init: Annotated[
        str, typer.Option(help="Of runs that do not say: auto, motion, pairwise, truth, a file.")
    ] = "auto",
    output: Annotated[
        list[Path],
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Where the table (.csv) or a picture (.png, .svg, .pdf) goes; may be repeated.",
        ),
    ] = [],  # noqa: B006 - typer copies it
    calibration: CalibrationOption = None,
    streams: StreamsOption = None,
    since: FromOption = None,
    until: ToOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Run several filters or settings on one log: errors, consistency and time in one table.

    A run that fails is a row with its error (exit code 3).

    Examples:
      clt compare log.mcap --filters eskf,ukf --init truth
      clt compare log.mcap --runs "a=--init truth" --runs "b=--set gate=5"
    """
    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.cli.period import parse_period
    from clt.core.errors import UsageError

    console = Console(quiet, verbose)
    tables = named_runs(filters, runs, init)
    for path in output:
        if path.suffix.lower() not in {TABLE_SUFFIX, *PICTURE_SUFFIXES}:
            raise UsageError(f"{path}: neither a table (.csv) nor a picture (.png, .svg, .pdf)")
    period = parse_period(since, until)
    inputs = Inputs.of(log, calibration=calibration, streams=streams)
    for path in output:
        inputs.check(path, force)
    from clt.cli.compiling import announce_compilation
    from clt.studies.comparison import compare_runs, plans_of

    plans = plans_of(tables, filter_environment())
    _, recording = read_for_estimate(log, inputs, period, console)
    require_data(recording, str(log))
    with announce_compilation(console):
        found = compare_runs(recording, plans)
    report_runs(found, console)
    for path in output:
        write_result(path, found, inputs, force)
    print_comparison(found, log, recording, console, as_json)
    return console.code if any(one.outcome.error == "" for one in found) else 1


def filter_environment() -> dict[str, object]:
    """Settings of filters from the environment, by dotted key."""
    from clt.core.settings import settings_from_environment
    from clt.model.settings import FilterSettings

    return settings_from_environment(FilterSettings)


def named_runs(filters: str | None, runs: list[str], init: str) -> dict[str, RunTable]:
    """The runs that `--filters` and `--runs` ask for. Raises UsageError for a slip."""
    from clt.core.errors import UsageError
    from clt.studies.document import RunTable

    if filters is None and len(runs) == 0:
        raise UsageError("nothing to compare; name filters (--filters eskf,ukf) or --runs")
    words = [] if filters is None else [word.strip() for word in filters.split(",")]
    found: dict[str, RunTable] = {}
    for name, table in [
        *((word, RunTable(filter=word, init=init)) for word in words),
        *(parse_run(text, init) for text in runs),
    ]:
        if name in found:
            raise UsageError(f"two runs have the name {name}")
        found[name] = table
    return found


def parse_run(text: str, init: str) -> tuple[str, RunTable]:
    """A run from `NAME=OPTIONS`. Raises UsageError."""
    import argparse
    import shlex

    from clt.core.errors import UsageError
    from clt.core.settings import parse_assignments
    from clt.studies.document import RunTable

    name, sign, options = text.partition("=")
    if sign == "" or name.strip() == "":
        raise UsageError(f'--runs {text}: expected NAME=OPTIONS, e.g. "a=--filter ukf"')
    parser = argparse.ArgumentParser(add_help=False, exit_on_error=False, allow_abbrev=False)
    for option in ("--filter", "--frame", "--engine", "--config"):
        parser.add_argument(option)
    parser.add_argument("--init", default=init)
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--as-received", action="store_true")
    try:
        given, rest = parser.parse_known_args(shlex.split(options))
    except (argparse.ArgumentError, ValueError) as error:
        raise UsageError(f"--runs {name}: {error}") from None
    if len(rest) > 0:
        raise UsageError(f"--runs {name}: unknown word {rest[0]}")
    values = {key: value for key, value in vars(given).items() if value is not None}
    return name.strip(), RunTable(**{**values, "set": parse_assignments(given.set)})


def report_runs(found: tuple[Compared, ...], console: Console) -> None:
    """Say which runs failed or are partial."""
    from clt.core.diagnostics import Diagnostic

    for one in found:
        if one.outcome.error != "":
            values = {"error": one.outcome.error}
            console.report([Diagnostic("run_failed", one.name, "partial", values)])
        else:
            console.report(one.diagnostics, about=one.name)


def write_result(path: Path, found: tuple[Compared, ...], inputs: Inputs, force: bool) -> None:
    """The table or the picture, by the suffix of the path."""
    from clt.cli.reports.compare_report import comparison_csv

    with inputs.output(path, force) as file:
        if path.suffix.lower() == TABLE_SUFFIX:
            file.write(comparison_csv(found).encode())
            return
        from clt.report.figures.style import IMAGE_FORMATS
        from clt.studies.comparison import draw_comparison

        draw_comparison(file, IMAGE_FORMATS[path.suffix.lower()], found)


def print_comparison(
    found: tuple[Compared, ...], log: Path, recording: Recording, console: Console, as_json: bool
) -> None:
    """One object, or one table."""
    import json

    from clt.cli.numbers import without_nan
    from clt.cli.reports.compare_report import comparison_document, print_comparison_table

    if as_json:
        head = {"log": str(log), "robots": list(recording.team.names)}
        document = {**head, "runs": comparison_document(found), "diagnostics": console.diagnostics}
        print(json.dumps(without_nan(document), allow_nan=False))
        return
    print_comparison_table(found)
