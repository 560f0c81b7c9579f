"""`clt emit`: a log as the bytes of a device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clt.cli.options import ForceOption, JsonOption, LogArgument, QuietOption, VerboseOption

if TYPE_CHECKING:
    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.core.recording import Recording
    from clt.devices.emission.emission import Emission
    from clt.devices.emission.play import Sent
    from clt.devices.emission.sinks import Sink
    from clt.devices.sources.source import SourceUrl

EMIT_ROLES = frozenset({"odometry", "ranges", "frames", "truth"})
SCHEMES = ("serial", "udp", "tcp", "tcp-listen")
MAX_RATE = 1e6


def emit(
    *,
    log: LogArgument,
    proto: Annotated[
        str,
        typer.Option(
            metavar="P",
            help="dwm1001, lps-sniffer, makerfabs, ndjson, qorvo-cli, rcl, trek1000, vesc or "
            "vesc-can.",
        ),
    ],
    output: Annotated[
        str,
        typer.Option(
            "-o",
            "--output",
            metavar="URL",
            help="serial:PORT, udp:HOST:PORT, tcp:HOST:PORT, tcp-listen:HOST:PORT, a path, which "
            "is written at once, or `-`.",
        ),
    ],
    robot: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Whose device it is: dwm1001, qorvo-cli, vesc."),
    ] = None,
    rate: Annotated[
        float, typer.Option(metavar="R", help="Times as fast as it was; 0: as fast as possible.")
    ] = 1.0,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Play a log out as the bytes of a device, for `clt record` without hardware.

    Examples:
      clt emit log.mcap --proto rcl -o capture.bin
      clt emit log.mcap --proto trek1000 -o udp:127.0.0.1:9000 --rate 2
    """
    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.core.errors import UsageError
    from clt.devices.emission.emission import prepare_emission
    from clt.devices.emission.source_words import source_words
    from clt.log.recording.load import load

    console = Console(quiet, verbose)
    if not 0.0 <= rate <= MAX_RATE:
        raise UsageError(f"--rate {rate:g}: give a number from 0 to a million")
    if as_json and output == "-":
        raise UsageError("--json and -o - both want standard output; name a file")
    check_proto(proto)
    inputs, url = Inputs.of(log), output_url(output)
    if url is None:
        inputs.check(Path(output), force)
    loaded = load(log, want=EMIT_ROLES)
    console.report_faults(loaded.recording.faults)
    check_robot(loaded.recording, proto, robot, loaded.path)
    emission = prepare_emission(loaded.recording, proto, robot, loaded.path)
    words = source_words(emission, url, output)
    console.say(f"read back with: clt record -o LOG --source {words}")
    report_not_reported(console, loaded.recording, emission)
    with open_output(inputs, url, output, force, console) as sink:
        sent = play_out(emission, sink, 0.0 if is_whole_file(output, url) else rate, output)
    report_left_out(console, emission)
    print_emit_summary(console, emission, sent, output, words, as_json)
    return console.code


def check_proto(proto: str) -> None:
    """Raise UsageError for a protocol that has no encoder."""
    from clt.core.errors import UsageError
    from clt.core.settings import did_you_mean
    from clt.devices.encoders.table import ENCODERS

    if proto not in ENCODERS:
        raise UsageError(f"--proto {proto}: unknown{did_you_mean(proto, ENCODERS)}")


def check_robot(recording: Recording, proto: str, robot: str | None, log: str) -> None:
    """Raise UsageError unless a robot of the log is named just where the stream is of one."""
    from clt.core.errors import UsageError
    from clt.core.settings import did_you_mean
    from clt.devices.encoders.table import ENCODERS

    names = recording.team.names
    if not ENCODERS[proto].one_robot:
        if robot is not None:
            raise UsageError(f"--robot {robot}: a {proto} stream holds all robots; leave it out")
        return
    if robot is None:
        raise UsageError(
            f"--proto {proto}: a stream of one robot; add --robot, one of {', '.join(names)}"
        )
    if robot not in names:
        raise UsageError(f"--robot {robot}: not in {log}{did_you_mean(robot, names)}")


def output_url(output: str) -> SourceUrl | None:
    """Where the bytes go; None for a path. Raises UsageError for a URL that is none."""
    from clt.core.errors import UsageError
    from clt.core.settings import did_you_mean
    from clt.devices.sources.source import SourceUrl
    from clt.devices.sources.url import host_and_port, parse_url

    scheme, colon, rest = output.partition(":")
    if output == "-":
        return SourceUrl("-", "", {}, output)
    if scheme not in SCHEMES:
        if colon != "" and rest[:1].isalnum() and "/" not in scheme and not Path(output).exists():
            raise UsageError(
                f"-o {output}: unknown scheme{did_you_mean(scheme, SCHEMES)}; a path with a colon "
                f"is written as ./{output}"
            )
        return None
    url = parse_url(output)
    if scheme != "serial":
        host_and_port(url)
    return url


def is_whole_file(output: str, url: SourceUrl | None) -> bool:
    """Whether an ordinary file is written, which no pace leaves a trace in."""
    path = Path(output)
    return url is None and (path.is_file() or not path.exists())


@contextmanager
def open_output(
    inputs: Inputs, url: SourceUrl | None, output: str, force: bool, console: Console
) -> Iterator[Sink]:
    """A file, standard output or a connection. Raises CltError, UsageError."""
    from clt.devices.emission.sinks import SINKS, FileSink

    if url is None or url.scheme == "-":
        with inputs.output(Path(output), force) as file:
            yield FileSink(file)
        return

    def waiting() -> None:
        console.say(f"{output}: waiting for a reader")

    with SINKS[url.scheme](url, waiting) as sink:
        yield sink


def play_out(emission: Emission, sink: Sink, rate: float, output: str) -> Sent:
    """Send it. Raises CltError where the reader is gone."""
    from clt.core.errors import CltError
    from clt.devices.emission.play import play
    from clt.devices.emission.sinks import FileSink

    try:
        return play(emission, sink, rate)
    except (OSError, EOFError) as error:
        if isinstance(sink, FileSink):
            raise
        why = getattr(error, "strerror", None) or str(error) or "hung up"
        raise CltError(f"{output}: the reader is gone before the end: {why}") from None


def report_not_reported(console: Console, recording: Recording, emission: Emission) -> None:
    """Say what the log holds and no device of this kind reports."""
    from clt.core.diagnostics import Diagnostic

    counts = {
        "ranges": len(recording.ranges.stamp),
        "odometry": sum(len(one.stamp) for one in recording.odometry.values()),
        "packets": len(recording.frames.stamp),
        "truth": sum(len(one.stamp) for one in recording.truth.values()),
    }
    missing = {
        content: count
        for content, count in counts.items()
        if count > 0 and content not in emission.spec.carries
    }
    if len(missing) > 0:
        console.report(
            [Diagnostic("not_reported", emission.proto, "information", {"counts": missing})]
        )


def report_left_out(console: Console, emission: Emission) -> None:
    """Say what could not be carried."""
    from clt.core.diagnostics import Diagnostic

    counts = dict(emission.left_out)
    if len(counts) > 0:
        console.report([Diagnostic("left_out", emission.proto, "partial", {"counts": counts})])


def print_emit_summary(
    console: Console, emission: Emission, sent: Sent, output: str, words: str, as_json: bool
) -> None:
    """What was sent: one object on stdout, or one line on stderr."""
    import json

    if as_json:
        found = {"warnings": console.warnings, "diagnostics": console.diagnostics}
        counts = {"samples": emission.samples, "left_out": dict(emission.left_out)}
        head = {"output": output, "proto": emission.proto, "source": words, "map": emission.robots}
        sizes = {"frames": sent.frames, "bytes": sent.sent_bytes}
        print(json.dumps({**head, **sizes, **counts, **found}))
        return
    parts = ", ".join(f"{count} of {content}" for content, count in emission.samples.items())
    console.say(f"{output}: {sent.frames} frames, {sent.sent_bytes} bytes; samples {parts}")
