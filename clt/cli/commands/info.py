"""`clt info`: what is in a log."""

from __future__ import annotations

from clt.cli.options import Force, Json, Log, Quiet, Report, Streams, Verbose


def info(
    log: Log,
    output: Report = None,
    streams: Streams = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:
    """Tell robots, pairs, rates, gaps, truth and faults of a log.

    Examples:
      clt info run.mcap
      clt info bag.mcap --streams streams.toml --json
    """
    import json

    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.cli.memory import return_freed_memory
    from clt.cli.reports.info_report import show
    from clt.cli.reports.topics import described, guesses
    from clt.log.recording.load import load
    from clt.log.recording.summary import as_dict, summarize

    return_freed_memory()
    console = Console(quiet, verbose)
    inputs = Inputs.of(log, streams=streams)
    inputs.check(output, force)
    loaded = load(log, inputs["streams"], brief=True)
    console.detail(f"SHA-256 {loaded.sha256}")
    summary = summarize(loaded.recording)
    with inputs.report(output, force) as file:
        if as_json:
            document = as_dict(loaded, summary)
            document["topics"] = described(loaded.topics, loaded.used, guesses(loaded))
            print(json.dumps(document, allow_nan=False, indent=1), file=file)
        else:
            show(loaded, summary, file)
    console.report(loaded.recording.faults)
    return console.code
