"""`clt streams`: a first streams file for somebody else's log."""

from __future__ import annotations

from clt.cli.options import (
    ForceOption,
    JsonOption,
    LogArgument,
    QuietOption,
    ReportOption,
    VerboseOption,
)


def streams(
    log: LogArgument,
    output: ReportOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Write a first streams.toml for a foreign log, guessed from its topics and types.

    Examples:
      clt streams bag -o streams.toml
      clt streams bag.mcap
    """
    import json

    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.cli.messages.faults import fault_documents
    from clt.cli.reports.topics import topic_dicts
    from clt.core.printable import count_text
    from clt.log.output import STDOUT
    from clt.log.recording.mapping.foreign import draft_streams

    console = Console(quiet, verbose)
    inputs = Inputs.of(log)
    inputs.check(output, force)
    drafted = draft_streams(log)
    with inputs.report(output, force) as file:
        if as_json:
            guesses = {one.topic: one.about for one in drafted.guesses}
            document = {
                "log": drafted.log,
                "robots": list(drafted.robots),
                "topics": topic_dicts(drafted.topics, frozenset(), guesses),
                "streams": drafted.text,
                "diagnostics": fault_documents(drafted.faults),
            }
            print(json.dumps(document, indent=1), file=file)
        else:
            file.write(drafted.text)
    console.report_faults(drafted.faults)
    if output not in {None, STDOUT}:
        console.say(
            f"{output}: {count_text(len(drafted.robots), 'robot')}: {', '.join(drafted.robots)}"
        )
        console.say(f"check it, then: clt info {log} --streams {output}")
    return console.code
