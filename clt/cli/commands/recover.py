"""`clt recover`: salvage a damaged log."""

from __future__ import annotations

from clt.cli.common import refuse_two_outputs
from clt.cli.options import (
    ForceOption,
    JsonOption,
    LogArgument,
    OutputOption,
    QuietOption,
    VerboseOption,
)


def recover(
    log: LogArgument,
    output: OutputOption,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Copy everything sound of a damaged log into a sound one, and say what was lost.

    Examples:
      clt recover cut.mcap -o saved.mcap
    """
    import json

    from clt.cli.console import Console
    from clt.core.errors import UsageError
    from clt.log.mcap.bag import find_bag
    from clt.log.output import open_output as opened
    from clt.log.recording.recover import salvage_log as copy

    refuse_two_outputs(as_json, output)
    if log.is_dir():
        files = find_bag(log).files
        raise UsageError(f"{log}: is a folder: recover its files one by one, e.g. {files[0]}")
    console = Console(quiet, verbose)
    with opened(output, force, inputs=[log]) as file:
        saved = copy(log, file)
    console.report_faults(saved.faults)
    kept = f"{saved.messages} messages on {saved.channels} channels, {saved.documents} documents"
    console.say(
        f"{output}: saved {kept}; " + ("some data is lost" if console.code else "nothing lost")
    )
    for fault in saved.faults:
        console.detail(f"  {fault.kind}: {fault.count}")
    if as_json:
        faults = [dict(vars(fault)) for fault in saved.faults]
        counts = {"messages": saved.messages, "channels": saved.channels}
        found = {"faults": faults, "diagnostics": console.diagnostics}
        print(json.dumps({**counts, "documents": saved.documents, **found}, indent=1))
    return console.code
