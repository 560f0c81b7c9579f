"""`clt settings`: every key of `--set`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from clt.cli.options import ForceOption, JsonOption, QuietOption, ReportOption, VerboseOption

if TYPE_CHECKING:
    from clt.core.settings_table import SettingKey


def settings(
    key: Annotated[
        str | None, typer.Argument(metavar="[KEY]", help="A key, or the table of some keys.")
    ] = None,
    of: Annotated[
        Literal["localize", "simulate"],
        typer.Option(help="The command whose keys are wanted; init takes those of localize."),
    ] = "localize",
    output: ReportOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """List every key of --set with type, unit, default and one line.

    Examples:
      clt settings
      clt settings noise.sigma_range
      clt settings sensors.range --of simulate --json
    """
    import json
    from dataclasses import asdict

    from clt.cli.console import Console
    from clt.cli.inputs import Inputs

    console = Console(quiet, verbose)
    inputs = Inputs.of()
    inputs.check(output, force)
    found = select_keys(key, of)
    with inputs.report(output, force) as file:
        if as_json:
            table = {"keys": [asdict(one) for one in found], "diagnostics": console.diagnostics}
            print(json.dumps(table, allow_nan=False, indent=1), file=file)
        else:
            print("\n".join(key_table_lines(found)), file=file)
    return console.code


def select_keys(key: str | None, of: str) -> list[SettingKey]:
    """The keys of a command that are `key` or below it. Raises UsageError naming the nearest."""
    from clt.core.errors import UsageError
    from clt.core.settings import did_you_mean
    from clt.core.settings_table import setting_keys
    from clt.core.validation import shorten
    from clt.model.settings import FilterSettings
    from clt.sim.scenario import Scenario

    every = setting_keys(Scenario if of == "simulate" else FilterSettings)
    if key is None:
        return every
    found = [one for one in every if one.name == key or one.name.startswith(f"{key}.")]
    if len(found) == 0:
        names = [one.name for one in every]
        tables = {name.rpartition(".")[0] for name in names} - {""}
        hint = did_you_mean(key, [*names, *sorted(tables)])
        hint = "; clt settings lists all" if hint.startswith(";") else hint
        raise UsageError(f"unknown key `{shorten(key)}`{hint}")
    return found


def key_table_lines(keys: list[SettingKey]) -> list[str]:
    """A row per key: name, default, unit, type, and below it what it is."""
    import json

    rows = []
    for one in keys:
        default = "-" if one.default is None else json.dumps(one.default)
        rows.append((one.name, default, one.unit, one.type))
    head = ("key", "default", "unit", "type")
    widths = [max(len(row[k]) for row in [head, *rows]) for k in range(3)]
    table = []
    for row, about in zip([head, *rows], ["what it is", *(one.about for one in keys)], strict=True):
        cells = [cell.ljust(width) for cell, width in zip(row[:3], widths, strict=True)]
        table += ["  ".join([*cells, row[3]]), f"    {about}"]
    return table
