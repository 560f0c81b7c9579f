"""The compiled pass that links receptions to packets (see `clt.ranging.unwrap`)."""

from __future__ import annotations

from clt.core.arrays import Indices, Stamps
from clt.jit.compiled import compiled_noalloc

REMEMBERED_PACKETS = 256
"""So many packets of each robot are kept for receptions that are reported later."""
MAX_RECEPTION_AGE_NS = 8_000_000_000
"""A reception reported later than this (ns) is not believed: numbers may have restarted."""


@compiled_noalloc
def link_receptions(
    source: Indices,
    sequence: Indices,
    stamp: Stamps,
    heard: Indices,
    row: Indices,
    known: Indices,
    latest: Indices,
) -> None:
    """Fill `row` (n, robots) with that of the packet with each heard sequence number.

    All of `row`, of the memory `known` (robots, REMEMBERED_PACKETS) and of the rows `latest`
    [receiver, sender] is -1 before.
    """
    n, robots = heard.shape
    for k in range(n):
        receiver = source[k]
        for sender in range(robots):
            number = heard[k, sender]
            if number < 0 or sender == receiver:
                continue
            found = known[sender, number % REMEMBERED_PACKETS]
            if found < 0 or sequence[found] != number or found <= latest[receiver, sender]:
                continue
            if stamp[k] - stamp[found] < MAX_RECEPTION_AGE_NS:
                row[k, sender] = found
                latest[receiver, sender] = found
        known[receiver, sequence[k] % REMEMBERED_PACKETS] = k
