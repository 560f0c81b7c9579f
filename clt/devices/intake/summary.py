"""What a recording came to: figures of every source, and what was wrong with it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from clt.core.diagnostics import Diagnostic, Severity
from clt.devices.intake.tally import Tally
from clt.devices.stamping.stamping import MAX_CLOCKS

SUMMARY_FIELDS = (
    "bytes", "frames", "samples", "skipped_bytes", "tail_bytes", "bad_frames", "lost",
    "reconnects", "first_stamp_ns", "last_stamp_ns",
)  # fmt: skip
DAMAGE_FIELDS = ("lost", "bad_frames", "damaged_bytes", "undecoded_bytes", "reconnects")


def source_figures(tally: Tally) -> dict[str, int | None]:
    """The figures of one source, for `--json` and the log."""
    return {name: getattr(tally, name) for name in SUMMARY_FIELDS}


def nothing_decoded(tallies: Mapping[str, Tally]) -> bool:
    """Whether no source gave a frame that was understood."""
    return all(tally.frames == 0 for tally in tallies.values())


def summary_diagnostics(tallies: Mapping[str, Tally]) -> Iterator[Diagnostic]:
    """What the figures say."""
    for name, tally in tallies.items():
        if len(tally.named) > 0:
            names = dict(sorted(tally.named.items()))
            yield Diagnostic("robots_named", name, "information", {"names": names})
        if len(tally.unknown_ids) > 0:
            severity: Severity = "warning" if tally.samples > 0 else "partial"
            unknown = {
                "counts": dict(sorted(tally.unknown_ids.items())),
                "more": tally.more_unknown,
                "mapped": tally.mapped,
            }
            yield Diagnostic("unknown_ids", name, severity, unknown)
        if tally.unknown_turns > 0:
            values = {"count": tally.unknown_turns}
            yield Diagnostic("unknown_turns", name, "warning", values)
        if tally.clockless > 0:
            values = {"count": tally.clockless, "most": MAX_CLOCKS}
            yield Diagnostic("too_many_clocks", name, "warning", values)
        if tally.decoder_error != "":
            failure = {"error": tally.decoder_error, "proto": tally.proto}
            yield Diagnostic("decoder_failed", name, "partial", failure)
        if tally.bytes == 0:
            yield Diagnostic("no_bytes", name, "partial" if tally.live else "warning")
        if tally.frames == 0 and tally.bytes > 0:
            found = {"bytes": tally.bytes, "proto": tally.proto}
            yield Diagnostic("nothing_decoded", name, "partial", found)
        damage = {key: getattr(tally, key) for key in DAMAGE_FIELDS}
        if any(count > 0 for count in damage.values()):
            first = tally.first_bad_line
            line = {} if first is None else {"line": first[0], "text": first[1]}
            now = any(count > tally.earlier.get(key, 0) for key, count in damage.items())
            grade: Severity = "partial" if now else "information"
            yield Diagnostic("source_damaged", name, grade, damage | line)
