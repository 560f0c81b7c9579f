"""What happens while devices are recorded, in words."""

from __future__ import annotations

from clt.cli.messages.words import Texts, first_few, times_in_words
from clt.core.diagnostics import Diagnostic


def nothing_decoded_text(found: Diagnostic) -> str:
    """Bytes arrive, but no frame is found in them."""
    values = found.values
    return (
        f"source {found.subject}: {values['bytes']} bytes, but nothing decodes as "
        f"{values['proto']}: wrong protocol or baud?"
    )


def unknown_ids_text(found: Diagnostic) -> str:
    """Samples of nodes that a map lacks, or that are too many."""
    values = found.values
    ids = [f"{name} ({count})" for name, count in values["counts"].items()]
    named = first_few(ids, 5)
    if values["more"] > 0:
        named += f" and further ids ({values['more']})"
    if values["mapped"]:
        return (
            f"source {found.subject}: its map lacks {named}; kept as raw bytes only, add them to "
            "map="
        )
    return (
        f"source {found.subject}: no robot for {named}; kept as raw bytes only, name the robots "
        "with map="
    )


def named_text(found: Diagnostic) -> str:
    """Names that robots got because there was no map."""
    names = [f"{key} is {name}" for key, name in found.values["names"].items()]
    return f"source {found.subject}: without map=, {first_few(names, 8)}"


def lost_text(found: Diagnostic) -> str:
    """What did not arrive, and what of the frames was damaged."""
    values = found.values
    words = [
        ("lost", f"{values['lost']} lost"),
        ("bad_frames", f"{values['bad_frames']} bad frames"),
        ("damaged_bytes", f"{values['damaged_bytes']} bytes of damaged frames"),
        ("undecoded_bytes", f"{values['undecoded_bytes']} bytes not decoded (see --from)"),
        ("reconnects", f"connected again {times_in_words(values['reconnects'])}"),
    ]
    parts = [text for key, text in words if values[key] > 0]
    if values["bad_frames"] > 0 and "line" in values:
        parts.append(f"the first bad one is line {values['line']}: {values['text']}")
    return f"source {found.subject}: " + ", ".join(parts)


RECORDING_TEXTS: Texts = {
    "source_lost": "source {subject}: lost: {why}",
    "source_back": "source {subject}: back after {gap_s:.1f} s",
    "source_silent": "source {subject}: silent for {silent_s:g} s",
    "no_bytes": "source {subject}: not one byte arrived",
    "nothing_decoded": nothing_decoded_text,
    "datagrams_lost": "source {subject}: {lost} datagrams lost so far; they come faster than they "
    "are taken",
    "bytes_dropped": "source {subject}: bytes dropped; they come faster than they are written",
    "overload": "source {subject}: kept as raw bytes only for now; decoding does not keep up",
    "overload_over": "source {subject}: decoded again",
    "device_restarted": "source {subject}: the device began again; its clock was mapped again",
    "wall_clock_set": "the clock of this computer was set by {step_s:+.3f} s; the log goes on as "
    "before",
    "disk_low": "{subject}: only {free_bytes} bytes are free on the disk; ended (see --min-free)",
    "disk_full": "{subject}: the disk is full; ended, the last second may be missing",
    "decoder_failed": "source {subject}: the decoder {proto} failed ({error}); its bytes are kept: "
    "repair or update it, then --from",
    "unknown_ids": unknown_ids_text,
    "too_many_clocks": "source {subject}: more than {most} clocks; {count} samples are stamped as "
    "if the device gave no time",
    "robots_named": named_text,
    "unknown_turns": "source {subject}: the turn rate of {count} samples is unknown: written as 0 "
    "with a variance that says so; steering comes by steer=SOURCE",
    "source_damaged": lost_text,
}
