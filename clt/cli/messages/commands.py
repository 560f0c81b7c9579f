"""What the commands themselves found, in words."""

from __future__ import annotations

from clt.cli.messages.words import Texts

COMMAND_TEXTS: Texts = {
    "part_used": "{subject}: {text}",
    "log_failed": "{error}",
    "truth_offset_estimated": "time offset of the truth: {offset_s:+.4f} s, estimated from the "
    "motion (correlation {correlation:.3f})",
    "truth_offset_given": "time offset of the truth: {offset_s:+.6g} s, as given",
    "runs_not_whole": "{subject}: of {total:.0f} runs {failed:.0f} failed and {partial:.0f} were "
    "done in part",
    "run_failed": "{subject}: {error}",
    "runs_failed": "{count:.0f} runs failed: {error}",
    "not_scored": "{error}; drawn without errors",
}
