"""Commands that are imported when they run: `clt --help` knows only their names and one line each.

The work of `clt --help` does not grow with the options of the commands.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from clt.cli.console import EXIT_USAGE
from clt.cli.help import arrange_options, commands_in_order, group_of_command


class CommandEntry(NamedTuple):
    """One command."""

    place: str
    """`module:function`."""
    about: str
    """What `clt --help` says: the first line of the function's docstring."""
    many: str | None = None
    """It takes several logs: the suffix of each result in the folder that `-o` then names."""


def load_command(row: CommandEntry) -> Callable[..., int]:
    """Import the function of a command."""
    module, _, name = row.place.partition(":")
    found: Callable[..., int] = getattr(import_module(module), name)
    return found


def placeholders(rows: Mapping[str, CommandEntry]) -> dict[str, Any]:
    """Commands by task, of which only the names and a line each are known."""
    return {
        name: TyperCommand(name, help=rows[name].about, rich_help_panel=group_of_command(name))
        for name in commands_in_order(list(rows))
    }


def help_as_option(words: Sequence[str]) -> list[str]:
    """`clt help COMMAND` as `clt COMMAND --help`."""
    return [*words[1:2], "--help"] if words[:1] == ["help"] else list(words)


def load_command_for_logs(row: CommandEntry) -> Callable[..., int]:
    """Import the function of a command as the command line calls it."""
    if row.many is None:
        return load_command(row)
    from clt.cli.many import for_many_logs

    return for_many_logs(load_command(row), row.place, row.many)


def lazy_group(
    rows: Mapping[str, CommandEntry], wrap: Callable[[Callable[..., int]], Callable[..., None]]
) -> type[TyperGroup]:
    """A group of typer whose commands are `rows`, each function wrapped by `wrap`."""

    class Lazy(TyperGroup):
        """Placeholders in lists; the real command once it is called."""

        def __init__(self, **attributes: Any) -> None:
            super().__init__(**attributes)
            self.called: str | None = None
            self.commands = placeholders(rows)
            arrange_options(self)

        def list_commands(self, ctx: Any) -> list[str]:
            del ctx
            return list(self.commands)

        def resolve_command(self, ctx: Any, args: list[str]) -> Any:
            self.called = None
            name, command, rest = super().resolve_command(ctx, args)
            self.called = name
            return name, None if command is None else self.load(command.name), rest

        def main(
            self,
            args: Sequence[str] | None = None,
            prog_name: str | None = None,
            complete_var: str | None = None,
            standalone_mode: bool = True,
            windows_expand_args: bool = True,
            **extra: Any,
        ) -> Any:
            """Run; on its own, end with an exit code and one line for a usage error."""
            words = help_as_option(sys.argv[1:] if args is None else args)
            run = partial(super().main, words, prog_name, complete_var, False, windows_expand_args)
            if not standalone_mode:
                return run(**extra)
            self.called = None
            try:
                code = run(**extra)
            except TyperException as error:
                from clt.cli.failures import json_in_words, report_failure
                from clt.cli.usage import usage_line

                code = EXIT_USAGE
                if type(error).__name__ == "NoArgsIsHelpError":
                    print(error.format_message(), file=sys.stderr)
                else:
                    as_json = json_in_words(words)
                    report_failure(usage_line(error, self.called), code, as_json=as_json)
            sys.exit(code)

        def load(self, name: str | None) -> Any:
            """The command with all its options."""
            one = typer.Typer(add_completion=False)
            one.command(name)(wrap(load_command_for_logs(rows[str(name)])))
            return arrange_options(typer.main.get_command(one))

    return Lazy
