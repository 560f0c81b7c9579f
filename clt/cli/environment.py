"""One check of the `CLT_*` environment variables for every command."""

from __future__ import annotations

import os


def check_environment() -> None:
    """Raise UsageError for a `CLT_*` variable that no command knows."""
    if not any(name.startswith("CLT_") for name in os.environ):
        return
    from clt.core.settings import refuse_unknown_variables
    from clt.model.settings import FilterSettings
    from clt.sim.scenario import Scenario

    refuse_unknown_variables((FilterSettings, Scenario))
