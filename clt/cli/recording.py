"""What `clt record` does: options checked, a recording run or decoded again, and summed up."""

from __future__ import annotations

import hashlib
import json
import re
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any

from clt.cli.console import EXIT_FAILED, Console
from clt.cli.inputs import Inputs
from clt.cli.lasting_stderr import lasting_stderr
from clt.cli.messages.render import diagnostic_text
from clt.cli.provenance import run_record
from clt.cli.recording_display import open_display
from clt.cli.reports.record_report import print_record_summary
from clt.cli.stopping import stop_with
from clt.core.arrays import NS_PER_SECOND
from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError, UsageError
from clt.core.recording import Team
from clt.devices.intake.intake import Intake
from clt.devices.intake.summary import nothing_decoded, source_figures, summary_diagnostics
from clt.devices.intake.team import GrowingTeam, read_team
from clt.devices.recorder.again import decode_again, intake_again
from clt.devices.recorder.recorder import Recorder
from clt.devices.recorder.status import RecorderOptions
from clt.devices.source_spec import (
    PASSING_SCHEMES,
    SourceSpec,
    check_sources,
    override,
    parse_source,
    sources_of_file,
    store_sources,
)
from clt.devices.stamping.host_clock import HostClock, SystemTime
from clt.devices.storage.log_parts import LogParts, existing_parts, part_path
from clt.devices.storage.raw_log import SOURCES_KEY, START_KEY, read_raw_log
from clt.log.output import STDOUT, is_device, open_output

SIZE_UNITS = {"": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
LATEST_EPOCH_S = float(2**31 - 1)


@dataclass(frozen=True)
class RecordCommand:
    """The options of `clt record`."""

    output: Path
    source_words: tuple[str, ...]
    sources: Path | None
    team: Path | None
    duration_s: float | None
    count: int | None
    split_size: str | None
    split_duration_s: float | None
    flush_s: float
    stall_s: float | None
    """None: as usual."""
    reconnect: bool
    min_free: str
    epoch_s: float | None
    force: bool
    as_json: bool

    def check(self) -> None:
        """Raise UsageError for a number that makes no sense."""
        positive = {
            "--duration": self.duration_s,
            "--count": self.count,
            "--split-duration": self.split_duration_s,
            "--flush": self.flush_s,
        }
        for name, value in positive.items():
            if value is not None and not (isfinite(value) and value > 0):
                raise UsageError(f"{name} {value:g}: give a number above 0")
        if self.stall_s is not None and not (isfinite(self.stall_s) and self.stall_s >= 0.0):
            raise UsageError(f"--stall {self.stall_s:g}: give seconds, or 0 for never")
        if self.epoch_s is not None and not 0.0 <= self.epoch_s < LATEST_EPOCH_S:
            raise UsageError(f"--epoch {self.epoch_s:g}: give seconds since 1970")
        parts = self.split_size is not None or self.split_duration_s is not None
        if self.output == STDOUT and (parts or self.as_json):
            other = "--json" if self.as_json else "splitting"
            raise UsageError(f"{other} and -o - do not go together; name a file")
        if parts and is_device(self.output):
            raise UsageError(f"splitting and -o {self.output} do not go together; name a file")
        if self.split_size is not None:
            size_in_bytes("--split-size", self.split_size)

    @property
    def split_bytes(self) -> int | None:
        """Size from which a new file is begun; None for no limit."""
        return None if self.split_size is None else size_in_bytes("--split-size", self.split_size)

    @property
    def splits(self) -> bool:
        """Whether there are several files."""
        return self.split_size is not None or self.split_duration_s is not None


def size_in_bytes(option: str, text: str) -> int:
    """`512MB`, `1.5GB`, `1000`. Raises UsageError."""
    match = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)\s*([KMGT]?B?)", text.strip(), re.IGNORECASE)
    unit = "" if match is None else match[2].upper().removesuffix("B")
    size = -1.0 if match is None else float(match[1]) * SIZE_UNITS[f"{unit}B" if unit else ""]
    if size < 0 or (option == "--split-size" and size < 1):
        raise UsageError(f"{option} {text}: give a size such as 512MB")
    return int(size)


def given_sources(command: RecordCommand, inputs: Inputs) -> list[SourceSpec]:
    """The sources of the command line and of the file. Raises UsageError."""
    document = inputs["sources"]
    specs = [] if document is None else sources_of_file(document)
    return specs + [parse_source(text) for text in command.source_words]


def captured_files(specs: Sequence[SourceSpec]) -> tuple[Path, ...]:
    """The files of captured bytes among sources, pipes left out."""
    paths = (Path(spec.url.target) for spec in specs if spec.url.scheme in PASSING_SCHEMES)
    return tuple(path for path in paths if path.is_file())


def stream_digests(paths: Sequence[Path]) -> dict[str, str]:
    """SHA-256 of files of any size, by name."""
    found = {}
    for path in paths:
        with path.open("rb") as file:
            found[str(path)] = hashlib.file_digest(file, "sha256").hexdigest()
    return found


def known_team(inputs: Inputs) -> Team | None:
    """The robots of the team file, if there is one."""
    document = inputs["team"]
    return None if document is None else read_team(document)


def check_target(command: RecordCommand, inputs: Inputs) -> None:
    """Raise CltError unless the log, or the parts of it, may be written."""
    if not command.splits:
        inputs.check(command.output, command.force)
        return
    inputs.check(part_path(command.output, 0), command.force)
    for path in existing_parts(command.output):
        inputs.check(path, command.force)


@contextmanager
def opened_parts(
    command: RecordCommand, metadata: Mapping[str, Mapping[str, str]]
) -> Iterator[LogParts]:
    """The log, written under its final name from the start."""
    split_s = command.split_duration_s
    options: dict[str, Any] = {
        "force": command.force,
        "flush_s": command.flush_s,
        "split_bytes": command.split_bytes,
        "split_ns": None if split_s is None else round(split_s * NS_PER_SECOND),
    }
    if command.output == STDOUT or is_device(command.output):
        with open_output(command.output) as file:
            yield LogParts(command.output, metadata, stream=file, **options)
        return
    try:
        parts = LogParts(command.output, metadata, **options)
        for path in existing_parts(command.output) if command.splits else ():
            if path not in parts.paths:  # Of an earlier recording, which is overwritten.
                path.unlink()
        yield parts
    except OSError as error:
        if error.filename is None:
            raise CltError(f"{command.output}: {error.strerror or error}") from error
        raise


def record_sources(command: RecordCommand, console: Console) -> int:
    """Record until it is ended; returns the exit code."""
    command.check()
    documents = Inputs.of(sources=command.sources, team=command.team)
    specs = given_sources(command, documents)
    files = captured_files(specs)
    inputs = Inputs(files, documents.documents)
    if len(specs) == 0:
        raise UsageError(
            "no source given; e.g. --source uwb=serial:/dev/ttyACM0,proto=rcl, or --sources FILE"
        )
    check_sources(specs)
    team = known_team(inputs)
    min_free = size_in_bytes("--min-free", command.min_free)
    check_target(command, inputs)
    clock = HostClock(SystemTime())
    with lasting_stderr(), open_display(console) as display:

        def on_event(found: Diagnostic) -> None:
            display.clear()
            console.report([found])

        recorder = Recorder(
            specs,
            RecorderOptions(
                command.duration_s,
                command.count,
                RecorderOptions.stall_s if command.stall_s is None else command.stall_s,
                command.reconnect,
                min_free,
                splits=command.splits,
            ),
            clock,
            words=diagnostic_text,
            on_event=on_event,
            on_status=display.show,
        )
        recorder.open()
        stop_with(lambda number: stop(recorder, number))
        start = clock.now_ns()
        first = start if command.epoch_s is None else round(command.epoch_s * NS_PER_SECOND)
        run = run_record(
            inputs.digests(stream_digests(files)),
            **{SOURCES_KEY: store_sources(specs), START_KEY: str(first)},
        )
        with closing(recorder), opened_parts(command, {"clt.run": run}) as parts:
            intake = Intake(parts, specs, GrowingTeam(team), first, command.count)
            recorder.run(intake, parts)
    with lasting_stderr():
        return sum_up(command, console, intake, parts, (clock.now_ns() - start) / NS_PER_SECOND)


def stop(recorder: Recorder, number: int) -> None:
    """A signal came: finish the log; only a second Ctrl-C leaves out what still waits."""
    if number == signal.SIGINT or not recorder.is_stopping:
        recorder.stop()


def record_again(command: RecordCommand, log: Path, console: Console) -> int:
    """Decode the raw bytes of a log again; returns the exit code."""
    command.check()
    for option, given in {
        "--stall": command.stall_s is not None,
        "--no-reconnect": not command.reconnect,
    }.items():
        if given:
            raise UsageError(f"{option} is about devices, --from reads a log; leave it out")
    min_free = size_in_bytes("--min-free", command.min_free)
    inputs = Inputs.of(log, sources=command.sources, team=command.team)
    raw = read_raw_log(log)
    specs = override(raw.sources, given_sources(command, inputs))
    check_sources(specs)
    check_target(command, inputs)
    first = raw.start_ns if command.epoch_s is None else round(command.epoch_s * NS_PER_SECOND)
    run = run_record(
        inputs.digests(stream_digests([log])),
        **{SOURCES_KEY: store_sources(specs), START_KEY: str(first)},
    )
    options = RecorderOptions(command.duration_s, command.count, min_free_bytes=min_free)
    with opened_parts(command, {"clt.run": run}) as parts:
        team = known_team(inputs)
        intake = intake_again(replace(raw, sources=specs), parts, first, team, command.count)
        elapsed = decode_again(raw, intake, parts, options, lambda found: console.report([found]))
    console.report_faults(raw.faults)
    return sum_up(command, console, intake, parts, elapsed)


def sum_up(
    command: RecordCommand,
    console: Console,
    intake: Intake,
    parts: LogParts,
    duration_s: float,
) -> int:
    """Say what the recording came to; returns the exit code."""
    tallies = intake.tallies
    console.report(summary_diagnostics(tallies))
    figures = {name: source_figures(tally) for name, tally in tallies.items()}
    names = [str(path) for path in parts.paths]
    log = str(command.output) if not command.splits else names[0]
    if command.as_json:
        document: dict[str, Any] = {"log": log, "duration": duration_s, "sources": figures}
        if command.splits:
            document["logs"] = names
        document["warnings"] = console.warnings
        document["diagnostics"] = console.diagnostics
        print(json.dumps(document))
    else:
        out = sys.stderr if command.output == STDOUT else sys.stdout
        print_record_summary(names, duration_s, tallies, parts.size, out)
    if nothing_decoded(tallies):
        return EXIT_FAILED
    return console.code
