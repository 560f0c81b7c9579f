"""Whatever values a log holds: what is sent is understood, and the rest is counted."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.devices.encoders.table import ENCODERS
from clt.devices.samples import OdometrySample, PoseSample, RangeSample, SteeringSample
from tests.devices.device_streams import DECIMAL, NODES, device_stream

VALUES = st.one_of(
    st.floats(-200.0, 200.0),
    st.sampled_from([0.0, -0.0, 1e-9, 999.999999, 999.9951, 1000.0, -1e6, 1e6, 1e300]),
    st.sampled_from([float("nan"), float("inf"), -float("inf")]),
)
KINDS = {
    "ndjson": (RangeSample, OdometrySample, PoseSample, SteeringSample),
    "rcl": (RangeSample, OdometrySample),
    "vesc": (OdometrySample,),
    "vesc-can": (OdometrySample,),
}
PROTOCOLS = sorted(ENCODERS.keys() - {"lps-sniffer"})


def sample_of(kind, ns, nodes, values):
    a, b, c = values
    if kind is RangeSample:
        return RangeSample(0, ns, "", nodes[0], nodes[1], a, b)
    if kind is OdometrySample:
        return OdometrySample(0, ns, "", nodes[0], a, b)
    if kind is PoseSample:
        return PoseSample(0, ns, "", nodes[0], a, b, c)
    return SteeringSample(0, ns, "", nodes[0], a)


@pytest.mark.parametrize("proto", PROTOCOLS)
@settings(max_examples=30, deadline=None, derandomize=True)
@given(data=st.data())
def test_sent_or_counted(proto, data):
    nodes, kinds = NODES.get(proto, DECIMAL), KINDS.get(proto, (RangeSample,))
    encoder = ENCODERS[proto].make(nodes[0])
    rows = data.draw(
        st.lists(st.tuples(st.sampled_from(kinds), st.tuples(VALUES, VALUES, VALUES)), max_size=6)
    )
    sent = []
    for step, (kind, values) in enumerate(rows):
        ns = step * 50_000_000
        sent += [part for _, part in encoder.encode([sample_of(kind, ns, nodes, values)])]
    sent += [part for _, part in encoder.finish()]
    decoder = device_stream(proto).decoder()
    found = [*decoder.feed(b"".join(sent)), *decoder.finish()]
    assert (decoder.counts.bad_frames, decoder.counts.skipped_bytes) == (0, 0)
    assert len(found) + encoder.left_out.total() == len(rows)
