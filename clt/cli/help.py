"""How help pages look: commands by task, options by what they are for, no types on flags."""

from __future__ import annotations

import os
from typing import Any

COMMAND_GROUPS = {
    "Make a log": ("demo", "simulate", "record", "import", "range", "recover", "emit"),
    "Look": ("info", "streams", "plot", "export"),
    "Estimate": ("init", "calibrate", "localize"),
    "Judge": ("evaluate", "observability"),
    "Study": ("compare", "sweep"),
    "Set up": ("settings", "compile"),
}
"""Commands by task, as `clt --help` shows them."""
OPTION_GROUPS = {
    "What is read": frozenset(
        {"config", "sets", "calibration", "streams", "since", "until", "sources", "from_log"}
    ),
    "Output and messages": frozenset(
        {"output", "force", "as_json", "quiet", "verbose", "scene", "help"}
    ),
}
"""Parameters of commands by what they are for; those of the task itself stand first."""
VALUE_NAMES = {"path": "FILE", "str": "NAME", "int": "N", "float": "X", "Path": "FILE"}
"""What stands behind an option whose value has no name of its own, by its type."""


def group_of_command(name: str) -> str | None:
    """The task of a command."""
    return next((group for group, names in COMMAND_GROUPS.items() if name in names), None)


def commands_in_order(names: list[str]) -> list[str]:
    """Commands by task; others last."""
    known = [name for group in COMMAND_GROUPS.values() for name in group]
    return sorted(names, key=lambda name: known.index(name) if name in known else len(known))


def arrange_options(command: Any) -> Any:
    """Sort a command's options into groups and take the types off its flags and arguments."""
    for one in command.params:
        if one.param_type_name == "option":
            _arrange_option(one)
        else:
            one.display_type_rich = _no_type  # it has a name of its own already
    original = command.get_help_option

    def get_help_option(ctx: Any) -> Any:
        option = original(ctx)
        if option is not None:
            _arrange_option(option)
        return option

    command.get_help_option = get_help_option
    return command


def _arrange_option(option: Any) -> None:
    for group, names in OPTION_GROUPS.items():
        if option.name in names and option.rich_help_panel is None:
            option.rich_help_panel = group
    if option.is_flag:
        option.metavar = ""
    elif option.metavar is None:
        option.metavar = VALUE_NAMES.get(str(option.bare_type()))


def _no_type(*_: object, **__: object) -> None:
    """Show no type."""


def respect_no_color() -> None:
    """Let help pages be plain text where NO_COLOR asks for it, bold and dim included."""
    if os.environ.get("NO_COLOR", "") != "":
        os.environ["_TYPER_FORCE_DISABLE_TERMINAL"] = "1"  # read when typer imports rich
