"""What is said of a recording in the end."""

from __future__ import annotations

import pytest

from clt.devices.intake.summary import summary_diagnostics
from clt.devices.intake.tally import Tally


@pytest.mark.parametrize(("samples", "severity"), [(0, "partial"), (5, "warning")])
def test_a_map_that_names_nobody_leaves_nothing_to_use(samples, severity):
    tally = Tally("rcl", bytes=100, frames=10, samples=samples)
    tally.unknown_ids["7"] = 10
    (found,) = summary_diagnostics({"uwb": tally})
    assert (found.kind, found.severity) == ("unknown_ids", severity)
