"""The text formats of modules: makerfabs, dwm1001, qorvo-cli."""

from __future__ import annotations

from math import isnan

import pytest

from clt.core.errors import UsageError
from clt.devices.decoders.table import make_decoder

LEC = (
    b"DIST,4,AN0,022E,7.94,8.03,0.00,3.44,AN1,9280,7.95,0.00,0.00,5.68,AN2,DCAE,0.00,8.03,0.00,7.76,"
    b"AN3,5431,0.00,0.00,0.00,8.73,POS,6.95,5.37,-1.97,52"
)
SPLICED = (
    b"DIST,4,AN0,022E,7.94,8.03,0.00,3.44,AN1,9280,7.95,0.00,0,AN2,DCAE,0.00,8.03,0.00,7.76,"
    b"AN3,5431,0.00,0.00,0.00,8.73"
)
NTF = (
    b"SESSION_INFO_NTF: {session_handle=1, sequence_number=1, block_index=1, n_measurements=3\n\r"
    b' [mac_address=0x0001, status="SUCCESS", distance[cm]=245, RSSI[dBm]=-78.5];\r\n'
    b' [mac_address=0x0002, status="RX_TIMEOUT"];\r\n'
    b' [mac_address=0x00A3, status="SUCCESS", distance[cm]=-75]}\r\n'
)


def fed(proto, data, **options):
    decoder = make_decoder(proto, options, "uwb")
    found = [*decoder.feed(data), *decoder.finish()]
    return [(one.source, one.target, one.distance) for one in found], decoder.counts, found


def test_makerfabs():
    ranges, counts, found = fed(
        "makerfabs",
        b"AT+RANGE=tid:1,mask:04,seq:63,range:(0,0,30,0,0,0,0,0),"
        b"rssi:(0.00,0.00,-77.93,0.00,0.00,0.00,0.00,0.00)\r\n"
        b"AT+RANGE=tid:7,mask:0F,seq:128,range:(997,1321,911,738,0,0,0,0),"
        b"ancid:(3,1,2,0,-1,-1,-1,-1)\r\n"
        b"AT+RANGE=tid:1,mask:01,seq:0,range:(5, 0,0,0,0,0,0,0),\r\n rssi:(-80.00,0.00)\r\n"
        b"OK\r\n",
    )
    assert ranges == [
        ("t1", "a2", 0.3),
        ("t7", "a3", 9.97),
        ("t7", "a1", 13.21),
        ("t7", "a2", 9.11),
        ("t7", "a0", 7.38),
        ("t1", "a0", 0.05),
    ]
    assert found[0].received_power == -77.93
    assert isnan(found[1].received_power)
    assert [found[0].sequence, found[-1].sequence] == [63, 0]
    assert (counts.frames, counts.bad_frames, counts.skipped_bytes) == (4, 0, 4)


@pytest.mark.parametrize(
    "line",
    [
        b"AT+RANGE=tid:1,mask:04,seq:63,range:(0,0,30",
        b"AT+RANGE=tid:1,mask:100,seq:63,range:(0,0,30,0,0,0,0,0)",
        b"AT+RANGE=tid:1,mask:01,seq:63,range:(999999,0,30,0,0,0,0,0)",
        b"AT+RANGE=tid:1,mask:01,seq:63,range:(1-1,0,30,0,0,0,0,0)",
        b"AT+RANGE=tid:1,mask:01,seq:63,range:(1,0),ancid:(-1,0)",
        b"AT+RANGE=tid:1,mask:01,seq:63,range:(1,0,0),ancid:(1,0)",
    ],
)
def test_damaged_lines_of_makerfabs(line):
    ranges, counts, _ = fed("makerfabs", line + b"\n")
    assert ranges == []
    assert (counts.frames, counts.bad_frames) == (0, 1)


def test_lec_and_les_lines_of_a_dwm1001():
    ranges, counts, _ = fed(
        "dwm1001",
        b"dwm> lec\r\ndwm> " + LEC + b"\r\n"
        b"022E[7.94,8.03,0.00]=3.38 9280[7.95,0.00,0.00]=-0.49 le_us=3082 "
        b"est[6.97,5.17,-1.77,53]\r\n"
        b"POS,7.10,5.24,-2.03,53\r\nPOS,0,022E,7.10,5.24,-2.03,53,x09\r\nDIST,0\r\n",
        node="R1",
    )
    assert ranges == [
        ("R1", "022E", 3.44),
        ("R1", "9280", 5.68),
        ("R1", "DCAE", 7.76),
        ("R1", "5431", 8.73),
        ("R1", "022E", 3.38),
        ("R1", "9280", -0.49),
    ]
    assert (counts.frames, counts.bad_frames, counts.skipped_bytes) == (5, 0, 10)


@pytest.mark.parametrize(
    "line",
    [
        SPLICED,
        LEC[:70],
        LEC.replace(b"DIST,4", b"DIST,5"),
        b"022E[7.94,8.03,0.00]=3.38 9280[7.95,0.00,0",
        b"022E[7.94,8.03,0.00]=1000.00",
    ],
)
def test_damaged_lines_of_a_dwm1001(line):
    ranges, counts, _ = fed("dwm1001", line + b"\r\n", node="R1")
    assert ranges == []
    assert (counts.frames, counts.bad_frames, counts.skipped_bytes) == (0, 1, len(line) + 2)


def test_the_robot_of_a_module_must_be_named():
    with pytest.raises(UsageError, match="source uwb: `node` is missing; add node=ROBOT"):
        make_decoder("dwm1001", {}, "uwb")
    with pytest.raises(UsageError, match="source uwb: node=1: give a robot's name"):
        make_decoder("qorvo-cli", {"node": "1"}, "uwb")


class Module:
    """A DWM1001 as its user meets it: binary mode, shell, commands that toggle and repeat."""

    def __init__(self, shell, reporting):
        self.shell, self.reporting = shell, reporting
        self.last = b"lec" if reporting else b""
        self.typed = b""

    def receive(self, data):
        if not self.shell:
            self.shell = data.endswith(b"\r\r")
            return b"dwm> " if self.shell else b"@\x01\x01" * len(data)
        self.typed += data
        *commands, self.typed = self.typed.split(b"\r")
        for command in commands:
            self.last = command or self.last
            if self.last == b"lec":
                self.reporting = not self.reporting
        return data + b"\r\ndwm> " * len(commands)


@pytest.mark.parametrize("shell", [False, True])
@pytest.mark.parametrize("reporting", [False, True])
@pytest.mark.parametrize("last", [b"", b"lec"])
def test_reports_are_started_and_never_stopped(shell, reporting, last):
    module = Module(shell, shell and reporting)
    module.last = last or module.last
    decoder = make_decoder("dwm1001", {"node": "R1"}, "uwb")
    data, silent = decoder.start(), 0
    for tenth in range(120):
        data += decoder.poll(tenth / 10)
        answer = module.receive(data) if data != b"" else b""
        data = b""
        samples = decoder.feed(answer + (LEC + b"\r\n" if module.reporting else b""))
        silent = silent + 1 if len(samples) == 0 else 0
    assert silent == 0
    assert decoder.counts.frames >= (118 if shell and reporting else 60)


def test_a_module_that_reports_once_a_second_is_left_alone():
    decoder = make_decoder("dwm1001", {"node": "R1"}, "uwb")
    decoder.start()
    for tenth in range(300):
        assert decoder.poll(tenth / 10) == b""
        if tenth % 10 == 9:
            decoder.feed(LEC + b"\r\n")
    sent = [decoder.poll(30.0 + tenth / 10) for tenth in range(60)]
    assert sum(one != b"" for one in sent) == 1


def test_notifications_of_qorvo():
    ranges, counts, found = fed("qorvo-cli", b"ok\r\n" + NTF + NTF, node="R1")
    assert ranges == [("R1", "0x0001", 2.45), ("R1", "0x00a3", -0.75)] * 2
    assert (found[0].sequence, found[0].received_power) == (1, -78.5)
    assert [one.frame for one in found] == [0, 0, 1, 1]
    assert (counts.frames, counts.bad_frames, counts.skipped_bytes) == (2, 0, 4)


@pytest.mark.parametrize("at", range(20, len(NTF) - 4, 17))
def test_a_torn_notification_hides_no_other(at):
    ranges, counts, _ = fed("qorvo-cli", NTF[:at] + b"\r\n" + NTF + NTF, node="R1")
    assert len(ranges) == 4
    assert counts.frames == 2
    spliced, _, _ = fed("qorvo-cli", NTF[:at] + NTF, node="R1")
    assert len(spliced) == 2
