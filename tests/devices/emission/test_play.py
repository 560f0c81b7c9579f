"""Emitted bytes over every way out: what arrives, and when."""

from __future__ import annotations

import os
import pty
import socket
import threading
import time
import tty
from io import BytesIO

import pytest

from clt.core.errors import CltError
from clt.devices.decoders.table import make_decoder
from clt.devices.decoders.vesc import FULL_REQUEST, SELECTIVE_REQUEST, vesc_frame
from clt.devices.emission.emission import prepare_emission
from clt.devices.emission.play import play
from clt.devices.emission.sinks import SINKS, FileSink
from clt.devices.emission.source_words import source_words
from clt.devices.emission.vesc_requests import VescRequests
from clt.devices.sources.url import parse_url
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate


@pytest.fixture(scope="module")
def recording():
    return simulate(load_scenario("shi-sim", {"duration": 1.0}, {}))


def emission_of(recording, proto="rcl", robot=None):
    return prepare_emission(recording, proto, robot, "log")


def opened(text):
    url = parse_url(text)
    return SINKS[url.scheme](url, lambda: None)


def bytes_of(emission):
    return b"".join(data for _, data in emission)


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def background(work):
    """Run in a thread; the list holds what it returned once it is joined."""
    found = []
    thread = threading.Thread(target=lambda: found.append(work()), daemon=True)
    thread.start()
    return thread, found


def read_all(link):
    data = b""
    while (part := link.recv(1 << 16)) != b"":
        data += part
    return data


def test_a_file_gets_all_at_once(recording):
    file, emission = BytesIO(), emission_of(recording)
    began = time.monotonic()
    sent = play(emission, FileSink(file), 0.0)
    assert time.monotonic() - began < 5.0
    assert file.getvalue() == bytes_of(emission)
    assert sent.sent_bytes == len(file.getvalue())


def test_the_pace_is_the_devices(recording):
    """0.95 s between the first and the last frame, at twice the pace."""
    file, times = BytesIO(), []

    class Timed(FileSink):
        def write(self, data):
            times.append(time.monotonic())
            super().write(data)

    play(emission_of(recording), Timed(file), 2.0)
    assert 0.475 <= times[-1] - times[0] < 3.0
    assert file.getvalue() == bytes_of(emission_of(recording))


def test_tcp_to_a_reader_that_listens(recording):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]

        def receive():
            link, _ = server.accept()
            with link:
                return read_all(link)

        thread, found = background(receive)
        with opened(f"tcp:127.0.0.1:{port}") as sink:
            play(emission_of(recording), sink, 0.0)
        thread.join(10.0)
    assert found == [bytes_of(emission_of(recording))]


def test_tcp_for_a_reader_that_connects(recording):
    port = free_port()

    def receive():
        for _ in range(100):
            try:
                with socket.create_connection(("127.0.0.1", port), 5.0) as link:
                    return read_all(link)
            except ConnectionRefusedError:
                time.sleep(0.05)
        return b""

    thread, found = background(receive)
    with opened(f"tcp-listen:127.0.0.1:{port}") as sink:
        play(emission_of(recording), sink, 0.0)
    thread.join(10.0)
    assert found == [bytes_of(emission_of(recording))]


def test_datagrams_hold_whole_frames(recording):
    emission = emission_of(recording, "ndjson")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(5.0)
        with opened(f"udp:127.0.0.1:{receiver.getsockname()[1]}") as sink:
            thread, _ = background(lambda: play(emission, sink, 20.0))
            received = [receiver.recv(1 << 16) for _ in emission]
            thread.join(10.0)
            receiver.settimeout(0.1)
            with pytest.raises(TimeoutError):
                receiver.recv(1)
    assert received == [data for _, data in emission]
    assert all(data.endswith(b"\n") for data in received)


def test_nobody_listens_to_datagrams(recording):
    with opened(f"udp:127.0.0.1:{free_port()}") as sink:
        assert play(emission_of(recording), sink, 0.0).frames > 100


def test_a_serial_port(recording):
    pytest.importorskip("serial")
    emission = emission_of(recording, "trek1000")
    wanted = bytes_of(emission)
    ours, theirs = pty.openpty()
    tty.setraw(theirs)

    def receive():
        data = b""
        while len(data) < len(wanted):
            data += os.read(ours, 1 << 16)
        return data

    thread, found = background(receive)
    with opened(f"serial:{os.ttyname(theirs)}") as sink:
        play(emission, sink, 0.0)
        thread.join(10.0)
    os.close(ours)
    os.close(theirs)
    assert found == [wanted]


def test_a_controller_answers_polls_only(recording):
    """Every sample is the answer to one poll at rate 0, however the requests are cut."""
    emission = emission_of(recording, "vesc", "R3")
    expected = recording.odometry["R3"].v
    port = free_port()
    thread, _ = background(lambda: _serve(emission, port, 0.0))
    decoder, found = make_decoder("vesc", {"node": "R3", "poll": "1000"}, "odo"), []
    with _patient_connection(port) as link:
        link.settimeout(5.0)
        assert decoder.start() == b""
        for step in range(len(expected)):
            request = decoder.poll(float(step))
            link.sendall(request[:3])
            link.sendall(request[3:])
            while len(found) <= step:
                found += decoder.feed(link.recv(1 << 12))
    thread.join(10.0)
    assert [one.v for one in found] == pytest.approx(expected, abs=0.5 / 4614 + 1e-9)


def test_a_controller_answers_with_its_latest_speed(recording):
    """At four times the pace a poll in the middle is answered with the middle of the log."""
    emission = emission_of(recording, "vesc", "R3")
    port = free_port()
    thread, _ = background(lambda: _serve(emission, port, 1.0))
    decoder = make_decoder("vesc", {"node": "R3"}, "odo")
    with _patient_connection(port) as link:
        link.settimeout(5.0)
        link.sendall(decoder.poll(0.0))
        first = decoder.feed(link.recv(1 << 12))
        time.sleep(0.4)
        link.sendall(decoder.poll(1.0))
        second = decoder.feed(link.recv(1 << 12))
    thread.join(10.0)
    v = recording.odometry["R3"].v
    assert first[0].v == pytest.approx(v[0], abs=0.001)
    assert min(abs(second[0].v - v[5:])) < 0.001


def test_a_controller_that_nobody_polls_ends_with_its_log(recording):
    class Silent(FileSink):
        two_way = True

    emission = emission_of(recording, "vesc", "R3")
    assert play(emission, Silent(BytesIO()), 10.0) == (0, 0)


def _serve(emission, port, rate):
    with opened(f"tcp-listen:127.0.0.1:{port}") as sink:
        try:
            return play(emission, sink, rate)
        except EOFError:
            return None


def _patient_connection(port):
    for _ in range(100):
        try:
            return socket.create_connection(("127.0.0.1", port), 5.0)
        except ConnectionRefusedError:
            time.sleep(0.05)
    raise AssertionError("nobody listens")


def test_requests_of_a_host():
    requests = VescRequests()
    assert requests.take(b"\x00" + SELECTIVE_REQUEST + FULL_REQUEST[:3]) == [0x2E180]
    assert requests.take(FULL_REQUEST[3:] + vesc_frame(b"\x00")) == [None]
    assert requests.take(b"") == []


def test_a_reader_that_is_not_there_is_one_line():
    with pytest.raises(CltError, match="serial:/dev/nothing: cannot be opened: No such file"):
        opened("serial:/dev/nothing").__enter__()
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with pytest.raises(CltError, match=f"tcp-listen:127.0.0.1:{port}: cannot listen"):
            opened(f"tcp-listen:127.0.0.1:{port}").__enter__()


def test_the_words_that_read_it_back(recording):
    robots = "map=1:R1+2:R2+3:R3+4:R4+5:R5"
    words = {
        ("rcl", None, None): f"uwb=file:x.bin,proto=rcl,{robots}",
        ("vesc-can", None, None): f"odo=candump:x.bin,proto=vesc-can,{robots}",
        ("rcl", None, "-"): f"uwb=-,proto=rcl,{robots}",
        ("ndjson", None, "tcp:h:1"): "uwb=tcp-listen:h:1,proto=ndjson",
        ("ndjson", None, "tcp-listen:h:1"): "uwb=tcp:h:1,proto=ndjson",
        ("ndjson", None, "udp:h:1"): "uwb=udp:h:1,proto=ndjson",
        ("vesc", "R3", None): "odo=file:x.bin,proto=vesc,node=R3,period=0.05",
        ("dwm1001", "R3", None): "uwb=file:x.bin,proto=dwm1001,node=R3,"
        "map=0001:R1+0002:R2+0004:R4+0005:R5,period=0.05",
    }
    for (proto, robot, text), expected in words.items():
        url = None if text is None else parse_url(text)
        assert source_words(emission_of(recording, proto, robot), url, "x.bin") == expected


def test_a_log_without_what_the_device_reports_is_refused(recording):
    with pytest.raises(CltError, match="log: no packets, which is what lps-sniffer carries; clt"):
        emission_of(recording, "lps-sniffer")
    with pytest.raises(CltError, match="log: no odometry of R1, which is what vesc carries"):
        emission_of(recording, "vesc", "R1")
