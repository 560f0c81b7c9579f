"""What several commands do alike: read a log for an estimate, its settings, their choices."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.cli.period import Period
    from clt.core.document import Document
    from clt.core.recording import Communication, Recording
    from clt.log.recording.load import LoadedLog
    from clt.model.settings import FilterSettings

ESTIMATION_ROLES = frozenset({"odometry", "ranges", "frames", "truth"})
"""Roles of topics that an estimate needs."""


def read_for_estimate(
    log: Path, inputs: Inputs, period: Period, console: Console
) -> tuple[LoadedLog, Recording]:
    """A log as it is, and what of it an estimate is made from: ranged and calibrated."""
    from clt.cli.period import select_usable_part
    from clt.log.recording.load import load

    loaded = load(log, inputs["streams"], ESTIMATION_ROLES)
    recording = with_ranges(select_usable_part(loaded, period, console), console)
    if (document := inputs["calibration"]) is not None:
        from clt.calibration.apply import apply_calibration, read_calibration

        recording = apply_calibration(recording, read_calibration(document))
    return loaded, recording


def refuse_two_outputs(as_json: bool, output: Path | None) -> None:
    """Raise UsageError where `--json` and the result both want standard output."""
    from clt.core.errors import UsageError
    from clt.log.output import STDOUT

    if as_json and output == STDOUT:
        raise UsageError("--json and -o - both want standard output; name a file")


def check_choice(option: str, value: str, known: tuple[str, ...]) -> None:
    """Refuse a value that an option does not have. Raises UsageError naming the nearest."""
    from clt.core.errors import UsageError
    from clt.core.settings import did_you_mean

    if value not in known:
        raise UsageError(f"{option} {value}: unknown{did_you_mean(value, known)}")


def read_filter_settings(
    config: Path | Document | None, sets: list[str], network: Communication | None = None
) -> FilterSettings:
    """Settings by precedence: defaults < what the log records < file < environment < --set."""
    from clt.core.settings import parse_assignments, read_toml, settings_from_environment
    from clt.model.effective_settings import effective_settings
    from clt.model.settings import FilterSettings

    tree = {} if config is None else read_toml(config)
    layers = (
        ("environment", settings_from_environment(FilterSettings)),
        ("--set", parse_assignments(sets)),
    )
    return effective_settings((str(config), tree), layers, network)


def with_ranges(recording: Recording, console: Console) -> Recording:
    """The recording; a log of raw packets is ranged first, as `clt range` does."""
    if recording.ranges.stamp.size > 0 or recording.frames.stamp.size == 0:
        return recording
    from clt.cli.reports.ranging_report import recover_ranges

    return recover_ranges(recording, console)


def require_data(recording: Recording, log: str, *, standing: bool = False) -> None:
    """Raise CltError, naming the remedy, for a log that cannot be localized at all.

    A team that is `standing` throughout needs no odometry.
    """
    from clt.core.errors import CltError

    if len(recording.odometry) == 0 and len(recording.run.get("input_run", "")) > 0:
        raise CltError(f"{log} is already a result, without odometry and ranges; give its input")
    if len(recording.odometry) == 0 and not standing and len(recording.run) > 0:
        still = len(recording.team.moving) == 0
        remedy = "; `clt init` finds where robots stand that never move" if still else ""
        raise CltError(f"{log}: none of its robots has odometry, which localizing needs{remedy}")
    if len(recording.odometry) == 0 and not standing:
        raise CltError(
            f"{log}: no odometry found on /ROBOT/odom; name its topics with --streams FILE, "
            "which `clt streams` drafts"
        )
    if recording.ranges.stamp.size == 0:
        raise CltError(
            f"{log}: no ranges found on /ROBOT/uwb/range; name their topics with --streams FILE, "
            "which `clt streams` drafts"
        )
