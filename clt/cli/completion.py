"""What a shell offers when Tab is pressed: filters, keys of --set, robots of the given log."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any


def complete_filter(incomplete: str) -> list[str]:
    """Names of filters."""
    from clt.model.choices import FILTER_NAMES

    return [name for name in FILTER_NAMES if name.startswith(incomplete)]


def complete_setting(incomplete: str) -> list[str]:
    """Keys of `--set`, each with the sign behind which its value stands."""
    from clt.core.settings_table import setting_keys
    from clt.model.settings import FilterSettings

    names = (one.name for one in setting_keys(FilterSettings))
    return [f"{name}=" for name in names if name.startswith(incomplete)]


def complete_init(incomplete: str) -> list[str]:
    """Methods of `--init`; the shell itself completes files where none fits."""
    from clt.cli.options import INIT_METHODS

    return [name for name in INIT_METHODS if name.startswith(incomplete)]


def complete_export(incomplete: str) -> list[str]:
    """Formats of `clt export`."""
    from clt.exporters import EXPORT_FORMATS

    return [name for name in EXPORT_FORMATS if name.startswith(incomplete)]


def complete_frame(ctx: Any, incomplete: str) -> list[str]:
    """Frames, with the moving robots of the log on the command line if it can be read."""
    offered = ["world", *(f"ego:{name}" for name in _robots(ctx.params.get("log")))]
    return [one for one in offered if one.startswith(incomplete)]


def _robots(log: object) -> Iterator[str]:
    """Moving robots as the log's own record has them; none where that cannot be had at once."""
    from clt.log.recording.metadata import TEAM_RECORD, decode_team

    if not isinstance(log, Path | str) or not Path(log).is_file():
        return
    try:
        from mcap.reader import make_reader

        with Path(log).open("rb") as file:
            for record in make_reader(file).iter_metadata():
                if record.name == TEAM_RECORD:
                    yield from (robot.name for robot in decode_team(record.metadata).moving)
                    return
    except Exception:  # noqa: BLE001 - a shell that waits for names wants no error
        return
