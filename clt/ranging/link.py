"""The compiled pass that links receptions to packets (see `clt.ranging.unwrap`)."""

from __future__ import annotations

from clt.core.recording import Indices, Stamps
from clt.jit.compiled import compiled_noalloc

REMEMBERED_PACKETS = 256
"""So many packets of each robot are kept in mind for receptions told later."""
MAX_RECEPTION_AGE_NS = 8_000_000_000
"""A reception told later than this (ns) is not believed: sequence numbers may have begun anew."""


@compiled_noalloc
def link_receptions(
    source: Indices,
    sequence: Indices,
    stamp: Stamps,
    heard: Indices,
    row: Indices,
    known: Indices,
    told: Indices,
) -> None:
    """Fill `row` (n, robots) with that of the packet with each heard sequence number.

    All of `row`, of the memory `known` (robots, REMEMBERED_PACKETS) and of the latest rows `told`,
    [receiver, sender], is -1 before.
    """
    n, robots = heard.shape
    for k in range(n):
        receiver = source[k]
        for sender in range(robots):
            number = heard[k, sender]
            if number < 0 or sender == receiver:
                continue
            found = known[sender, number % REMEMBERED_PACKETS]
            if found < 0 or sequence[found] != number or found <= told[receiver, sender]:
                continue
            if stamp[k] - stamp[found] < MAX_RECEPTION_AGE_NS:
                row[k, sender] = found
                told[receiver, sender] = found
        known[receiver, sequence[k] % REMEMBERED_PACKETS] = k
