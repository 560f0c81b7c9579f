"""Sources one by one, without the recorder."""

from __future__ import annotations

import errno
import os
import pty
import socket
import sys
import tty
from contextlib import suppress

import pytest

from clt.core.errors import CltError, UsageError
from clt.devices.sources import serial_port, table
from clt.devices.sources.source import DisconnectedError, Joined, Opening, SourceKind
from clt.devices.sources.table import SOURCES, find_source
from clt.devices.sources.url import parse_url
from clt.devices.stamping.host_clock import HostClock, SystemTime
from tests.devices.clocks import FakeTime


def opened(text, *, clock=None, **more):
    url = parse_url(text)
    kind = SOURCES[url.scheme]
    kind.check(url)
    return kind.open(url, Opening(clock or HostClock(SystemTime()), **more))


def read_all(connection, patience=20):
    """Chunks until nothing comes or it ends."""
    found = []
    for _ in range(patience):
        try:
            chunks = connection.read(0.02)
        except EOFError:
            break
        found += chunks
    return found


@pytest.mark.parametrize("text", ["ttyACM0", "9:x", "", "Serial:x", "x y:z"])
def test_a_text_that_is_no_url(text):
    with pytest.raises(UsageError, match="is no source: write SCHEME:TARGET"):
        parse_url(text)


def test_the_parts_of_a_url():
    assert parse_url("serial:/dev/a:b?baud=9600&x=1")[:3] == (
        "serial", "/dev/a:b", {"baud": "9600", "x": "1"},
    )  # fmt: skip
    assert parse_url("-")[:3] == ("-", "", {})


def test_datagrams_beyond_the_buffer_are_counted():
    """The kernel says how many it dropped with the next datagram that is received."""
    receiver = opened("udp:127.0.0.1:0?buffer=4096")
    address = receiver._socket.getsockname()
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for k in range(200):
        sender.sendto(b"%d" % k, address)
    kept = read_all(receiver)
    sender.sendto(b"end", address)
    kept += read_all(receiver)
    assert kept[-1].data == b"end"
    assert 0 < len(kept) < 200
    assert len(kept) + receiver.lost == 201
    sender.close()
    receiver.close()


def test_datagrams_are_stamped_when_the_kernel_has_them():
    clock = HostClock(SystemTime())
    receiver = opened("udp:127.0.0.1:0", clock=clock)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(b"x", receiver._socket.getsockname())
        sent = clock.now_ns()
        clock.host.sleep(0.2)
        (chunk,) = receiver.read(0.5)
    assert chunk.host_ns - sent < 100_000_000
    receiver.close()


def test_clients_are_streams_of_their_own_and_leave():
    server = opened("tcp-listen:127.0.0.1:0")
    address = server._server.getsockname()
    one, other = socket.create_connection(address), socket.create_connection(address)
    one.sendall(b"a")
    other.sendall(b"b")
    came = read_all(server)
    assert [one.stream for one in came if isinstance(one, Joined)] == [1, 2]
    streams = {one.data: one.stream for one in came if not isinstance(one, Joined)}
    assert sorted(streams.values()) == [1, 2]
    one.close()
    assert [(c.data, c.stream) for c in read_all(server)] == [(b"", streams[b"a"])]
    third = socket.create_connection(address)
    third.sendall(b"c")
    came = [one for one in read_all(server) if not isinstance(one, Joined)]
    assert [(one.data, one.stream) for one in came] == [(b"c", streams[b"a"])]
    server.write(b"poll")
    assert other.recv(10) == b"poll"
    for client in (other, third):
        client.close()
    server.close()


def test_a_server_that_goes_away():
    with socket.create_server(("127.0.0.1", 0)) as server:
        client = opened(f"tcp:127.0.0.1:{server.getsockname()[1]}")
        device, _ = server.accept()
        device.sendall(b"abc")
        assert read_all(client, 2)[0].data == b"abc"
        client.write(b"hello")
        assert device.recv(10) == b"hello"
        device.close()
    with pytest.raises(DisconnectedError, match="closed the connection") as found:
        client.read(1.0)
    assert found.value.in_order
    client.close()


def test_a_serial_port_is_ours_alone():
    master, slave = pty.openpty()
    tty.setraw(slave)
    port = opened(f"serial:{os.ttyname(slave)}?baud=921600")
    with pytest.raises(DisconnectedError, match="another program has it open"):
        opened(f"serial:{os.ttyname(slave)}")
    os.write(master, b"abc")
    assert b"".join(chunk.data for chunk in read_all(port, 3)) == b"abc"
    port.write(b"poll")
    assert os.read(master, 10) == b"poll"
    os.close(slave)
    os.close(master)
    with pytest.raises(DisconnectedError):
        read_all(port)
    port.close()


def test_serial_ports_need_an_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(CltError, match=r"serial ports need pyserial: pip install 'clt\[serial\]'"):
        serial_port.check_serial(parse_url("serial:ttyACM0"))


def test_a_file_as_fast_as_possible_and_in_small_pieces(tmp_path):
    path = tmp_path / "in"
    path.write_bytes(bytes(5000))
    one = opened(f"file:{path}", block_bytes=1024)
    assert [len(chunk.data) for chunk in read_all(one)] == [1024] * 4 + [904]
    one.close()
    with pytest.raises(DisconnectedError, match="No such file"):
        opened(f"file:{tmp_path}/none")


@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_a_file_at_the_pace_of_the_device(tmp_path, rate):
    """Device time is the count of bytes, in ms."""
    path = tmp_path / "in"
    path.write_bytes(bytes(2560))
    host = FakeTime()
    clock = HostClock(host)
    fed = [0]

    def device_time(data):
        fed[0] += len(data)
        return fed[0] * 1e-3

    one = opened(f"file:{path}?rate={rate}", clock=clock, device_time=device_time)
    begin, arrivals = clock.now_ns(), []
    for _ in range(1000):
        try:
            arrivals += [chunk.host_ns - begin for chunk in one.read(0.05)]
        except EOFError:
            break
    steps = [k * 256_000_000 / rate for k in range(10)]
    assert arrivals == pytest.approx(steps, abs=1e6)
    one.close()


def test_a_can_interface_that_is_not_there():
    causes = "|".join(os.strerror(one) for one in (errno.EAFNOSUPPORT, errno.ENODEV))
    with pytest.raises(DisconnectedError, match=causes):
        opened("can:none0")


class Plugin:
    """An entry point."""

    name, value = "mine", "somewhere:KIND"

    def __init__(self, loaded):
        self.loaded = loaded

    def load(self):
        if isinstance(self.loaded, Exception):
            raise self.loaded
        return self.loaded


def test_sources_of_third_parties(monkeypatch):
    kind = SourceKind(lambda *_: None, lambda _: None)
    for loaded, said in (
        (kind, None),
        (ImportError("no\nway"), "does not load: ImportError: no; repair"),
        (7, "is a int, no SourceKind"),
    ):
        monkeypatch.setattr(table, "source_plugins", lambda one=loaded: {"mine": Plugin(one)})
        if said is None:
            assert find_source("mine", "source x") is kind
        else:
            with pytest.raises(CltError, match=said):
                find_source("mine", "source x")


def test_a_port_that_takes_nothing_holds_nobody_up():
    """What is sent to a device that does not read is given up; the port stays open."""
    terminal, device = pty.openpty()
    tty.setraw(device)
    port = opened(f"serial:{os.ttyname(device)}")
    written = 0
    with suppress(DisconnectedError):
        while written < 1 << 20:
            port.write(bytes(256))
            written += 256
    assert written < 1 << 20
    os.write(terminal, b"still")
    assert b"".join(one.data for one in read_all(port, 5)) == b"still"
    port.close()
    os.close(terminal)
    os.close(device)


def test_another_side_that_takes_nothing_holds_nobody_up():
    server = socket.create_server(("127.0.0.1", 0))
    client = opened(f"tcp:127.0.0.1:{server.getsockname()[1]}")
    peer, _ = server.accept()
    listener = opened("tcp-listen:127.0.0.1:0")
    reader = socket.create_connection(listener._server.getsockname())
    assert [one.stream for one in read_all(listener, 5)] == [1]
    for _ in range(64):
        client.write(bytes(1 << 20))
        listener.write(bytes(1 << 20))
    peer.sendall(b"still")
    reader.sendall(b"there")
    assert b"".join(one.data for one in read_all(client, 5)) == b"still"
    assert b"".join(one.data for one in read_all(listener, 5)) == b"there"
    for one in (server, client, peer, listener, reader):
        one.close()


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel of Linux counts")
def test_datagrams_lost_after_the_last_one_received_are_counted():
    """No later datagram brings the number of these."""
    receiver = opened("udp:127.0.0.1:0?buffer=4096")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for _ in range(200):
            sender.sendto(bytes(50), receiver._socket.getsockname())
    kept = len(read_all(receiver, 3))
    assert 0 < kept < 200
    assert receiver.lost == 200 - kept
    receiver.close()
    assert receiver.lost == 200 - kept
