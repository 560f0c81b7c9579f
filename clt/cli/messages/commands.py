"""What the commands themselves found, in words."""

from __future__ import annotations

from clt.cli.messages.words import Texts

COMMAND_TEXTS: Texts = {
    "part_used": "{subject}: {text}",
    "log_failed": "{error}",
    "not_scored": "{error}; drawn without errors",
    "file_incomplete": "{subject}: no initial pose in the file, and {error}",
    "start_note": "{text}",
    "uncertain_start": "{subject} ({status}): {why}",
}
