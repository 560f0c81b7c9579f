"""Where the states of range errors stand."""

from __future__ import annotations

import numpy as np

from clt.model.range_errors import MAX_SHARED_STATES, lay_out_range_errors
from clt.model.settings import FilterSettings
from tests.model.range_tables import ranges, table_of

ROWS = [(1, 2, 3, 2.0), (1, 0, 2, 3.0), (2, 2, 1, 4.0), (2, 3, 2, 5.0)]
"""R1-R2 twice, A1-R1, R1-A2."""


def laid_out(first=6, gate=None, **noise):
    measured = ranges(ROWS)
    table, _ = table_of(measured)
    settings = FilterSettings(gate=gate, noise=noise)
    return table, lay_out_range_errors(table, measured, first, settings)


def test_pairs_are_numbered_whoever_measured():
    table, _ = laid_out()
    assert table.pair[0] == table.pair[3]
    assert np.unique(table.pair).tolist() == [0, 1, 2]


def test_without_settings_blocked_pairs_share_states():
    _, (errors, sigma, nodes) = laid_out()
    assert errors.shared.tolist() == [6, 7, 8]
    assert len(sigma) == min(3, MAX_SHARED_STATES)
    assert nodes == ()
    assert np.all(errors.slow == -1)
    assert errors.gain == -1


def test_a_gate_needs_no_states():
    _, (errors, sigma, _) = laid_out(gate=9.0)
    assert sigma == ()
    assert errors.outliers.active == 0


def test_offsets_of_nodes_then_gain_then_slow_errors():
    table, (errors, sigma, nodes) = laid_out(offset=0.3, gain=0.05, slow=0.2)
    assert nodes == (0, 1, 2, 3)
    assert sigma == (0.3, 0.3, 0.3, 0.3, 0.05, 0.2, 0.2, 0.2)
    assert errors.gain == 10
    assert errors.slow.tolist() == [11, 12, 13]
    assert errors.shared.size == 0
    q = table.pair[1]
    assert {errors.offset_a[q], errors.offset_b[q]} == {6, 8}  # A1, R1
