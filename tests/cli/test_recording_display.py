"""What is shown while devices are recorded."""

from __future__ import annotations

import io

import pytest
from rich.console import Console as Terminal

from clt.cli.console import Console
from clt.cli.recording import size_in_bytes
from clt.cli.recording_display import LineDisplay, Rates, age_text, status_table
from clt.cli.reports.record_report import print_record_summary, size_text
from clt.core.errors import UsageError
from clt.devices.intake.tally import Tally
from clt.devices.recorder.status import SourceStatus, Status

NOW = 1_700_000_000_000_000_000


def status(elapsed, frames, connected=True):
    tally = Tally("rcl", bytes=2_500_000, frames=frames, bad_frames=3, arrived_ns=NOW - 400_000_000)
    tally.lost = 407
    tally.last_value = ("range", "R1-R2", 3.21)
    sources = (
        SourceStatus("uwb", tally, connected),
        SourceStatus("odo", Tally("vesc"), True),
    )
    return Status(elapsed, 1_234_567, 0.25, NOW, sources)


def test_a_line_every_ten_seconds(capsys):
    display = LineDisplay(Console())
    for tenth in range(301):
        display.show(status(tenth / 10, 100 * tenth))
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    assert lines[0] == (
        "10 s, 1.2 MB; uwb 1000 frames/s, range R1-R2 3.210 m, 3 bad, 0 bytes skipped, 407 lost, "
        "0.4 s ago; odo 0 frames/s, -, 0 bad, 0 bytes skipped, 0 lost, nothing yet"
    )


def test_silence_when_asked(capsys):
    LineDisplay(Console(quiet=True)).show(status(20.0, 100))
    assert capsys.readouterr().err == ""


def test_rates_are_those_of_the_last_seconds():
    rates = Rates()
    found = [rates.take(status(k / 4, 100 * min(k, 40)))["uwb"] for k in range(1, 80)]
    assert found[30] == pytest.approx(400, rel=0.01)
    assert found[-1] == pytest.approx(0, abs=1)


def test_the_table_of_a_terminal():
    text = io.StringIO()
    Terminal(file=text, width=120).print(status_table(status(5.0, 100), {"uwb": 20.0, "odo": 0.0}))
    for word in ("uwb", "20", "range R1-R2 3.210 m", "0.4 s ago", "1.2 MB", "25 %", "Ctrl-C"):
        assert word in text.getvalue()


def test_a_source_that_is_gone():
    assert age_text(status(5.0, 1, connected=False).sources[0], NOW) == "gone 0.4 s"


def test_the_summary():
    text = io.StringIO()
    print_record_summary(["a.mcap", "b.mcap"], 2.0, {"uwb": Tally("rcl", frames=7)}, 999, text)
    assert text.getvalue().startswith("a.mcap to b.mcap: 2.0 s, 999 B\n  uwb  0 B, 7 frames, 0 ")


@pytest.mark.parametrize(
    ("text", "size"), [("512MB", 512_000_000), ("1.5 GB", 1_500_000_000), ("7", 7), ("2k", 2000)]
)
def test_sizes(text, size):
    assert size_in_bytes("--split-size", text) == size


@pytest.mark.parametrize("text", ["", "x", "-1", "1 PB", "0"])
def test_sizes_that_are_none(text):
    with pytest.raises(UsageError, match="give a size such as 512MB"):
        size_in_bytes("--split-size", text)


def test_sizes_as_people_say_them():
    assert [size_text(n) for n in (0, 999, 1500, 2e6, 3e12)] == [
        "0 B", "999 B", "1.5 kB", "2.0 MB", "3000.0 GB",
    ]  # fmt: skip
