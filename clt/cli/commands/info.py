"""`clt info`: what is in a log."""

from __future__ import annotations

from clt.cli.options import (
    ForceOption,
    JsonOption,
    LogArgument,
    QuietOption,
    ReportOption,
    StreamsOption,
    VerboseOption,
)


def info(
    log: LogArgument,
    output: ReportOption = None,
    streams: StreamsOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Show robots, pairs, rates, gaps, truth and faults of a log.

    Examples:
      clt info run.mcap
      clt info bag.mcap --streams streams.toml --json
    """
    import json

    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.cli.memory import return_freed_memory
    from clt.cli.messages.faults import fault_documents
    from clt.cli.reports.info_report import print_info
    from clt.cli.reports.topics import guesses_by_topic, topic_dicts
    from clt.log.recording.load import load
    from clt.log.recording.summary import info_dict, summarize_recording

    return_freed_memory()
    console = Console(quiet, verbose)
    inputs = Inputs.of(log, streams=streams)
    inputs.check(output, force)
    loaded = load(log, inputs["streams"], brief=True)
    console.detail(f"SHA-256 {loaded.sha256}")
    summary = summarize_recording(loaded.recording)
    with inputs.report(output, force) as file:
        if as_json:
            document = info_dict(loaded, summary)
            document["topics"] = topic_dicts(loaded.topics, loaded.used, guesses_by_topic(loaded))
            document["diagnostics"] = fault_documents(loaded.recording.faults)
            print(json.dumps(document, allow_nan=False, indent=1), file=file)
        else:
            print_info(loaded, summary, file)
    console.report_faults(loaded.recording.faults)
    return console.code
