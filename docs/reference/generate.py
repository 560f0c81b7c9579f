"""Write the reference pages from the code: commands, settings, files, topics and messages.

`make docs` runs this; the pages are not kept in git.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import typer
from pydantic import BaseModel

from clt.calibration.apply import (
    OdometryCalibration,
    PairCalibration,
    RangeCalibration,
)
from clt.cli.app import COMMANDS, app
from clt.core.settings_table import SettingKey, setting_keys
from clt.importers import IMPORT_FORMATS
from clt.initialization.given.poses import GivenPose
from clt.log.recording import channels, packets
from clt.log.recording.mapping.streamsfile import RangeStreams, RobotStreams, StreamsFile
from clt.log.recording.ranging import RANGE_FIELD_BY_TYPE
from clt.log.recording.roles import INNOVATION_TOPIC, ROLE_BY_LEAF
from clt.log.scene import scene
from clt.model.settings import FilterSettings
from clt.sim.scenario import Scenario

FOLDER = Path(__file__).parent
SCHEMAS = FOLDER.parents[1] / "schemas"
SCENARIOS = FOLDER.parents[1] / "clt" / "sim" / "scenarios"
MADE_BY = "<!-- Written by docs/reference/generate.py: change the code, not this page. -->"
OWN_MESSAGES = "clt_msgs"
SCENE_TOPICS = {"/tf": scene.TF_TYPE, "/clt/scene": scene.SCENE_TYPE}


def cell(text: str) -> str:
    """Text that a Markdown table holds as it is; code between backticks stays code."""
    parts = " ".join(text.split()).replace("|", "\\|").split("`")
    parts[::2] = [re.sub(r"([\[\]{}*_<])", r"\\\1", part) for part in parts[::2]]
    return "`".join(parts)


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table of cells that are Markdown already."""
    lines = [list(head)]
    lines += [["---"] * len(lines[0]), *(list(row) for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def load_commands() -> dict[str, Any]:
    """Every command by its name."""
    group = typer.main.get_command(app)
    return {name: group.load(name) for name in COMMANDS}


def value_name(parameter: Any) -> str:
    """What stands behind an option, or nothing for a switch."""
    if parameter.is_flag:
        return ""
    annotation = parameter.type_descriptor.annotation
    choices = [part for part in (annotation, *get_args(annotation)) if get_origin(part) is Literal]
    if len(choices) > 0:
        return " " + "/".join(str(choice) for choice in get_args(choices[0]))
    named = {float: "NUMBER", int: "N", Path: "PATH", str: "TEXT"}
    kinds = [named[part] for part in (annotation, *get_args(annotation)) if part in named]
    name = parameter.metavar or next(iter(kinds), "VALUE")
    return f" {name}".replace("|", "\\|")


def option_row(parameter: Any) -> tuple[str, str, str]:
    """Spelling, default and meaning of one option."""
    names = ", ".join(f"`{name}{value_name(parameter)}`" for name in parameter.opts)
    names += "".join(f", `{name}`" for name in parameter.secondary_opts)
    if parameter.required:
        default = "required"
    elif parameter.is_flag:
        default = (parameter.opts if parameter.default else ["", "-"])[-1].replace("--", "")
    else:
        default = "-" if parameter.default in (None, "", (), []) else f"`{parameter.default}`"
    if parameter.multiple:
        default = "none; may be repeated"
    return names, default, cell(parameter.help or "")


def argument_word(parameter: Any) -> str:
    """What stands for an argument."""
    word = (parameter.metavar or parameter.name.upper()).strip("[].")
    return f"{word}..." if parameter.nargs == -1 else word


def command_section(name: str, command: Any) -> str:
    """Everything about one command."""
    about, _, examples = str(command.help).partition("\n\nExamples:\n")
    arguments = [one for one in command.params if not one.opts[0].startswith("-")]
    options = [one for one in command.params if one.opts[0].startswith("-")]
    words = [argument_word(one) for one in arguments]
    shown = " ".join(
        word if one.required else f"[{word}]" for one, word in zip(arguments, words, strict=True)
    )
    needed = "".join(f" {one.opts[0]}{value_name(one)}" for one in options if one.required)
    parts = [f"## `clt {name}`", " ".join(about.split("\n\n")[0].split())]
    parts += [f"```text\nclt {name} {shown}{needed} [OPTIONS]\n```"]
    parts += [" ".join(rest.split()) for rest in about.split("\n\n")[1:]]
    if len(arguments) > 0:
        rows = [
            (f"`{word}`", cell(one.help or "")) for one, word in zip(arguments, words, strict=True)
        ]
        parts.append(table(("argument", "what it is"), rows))
    parts.append(table(("option", "default", "what it does"), map(option_row, options)))
    if len(examples) > 0:
        lines = "\n".join(line.strip() for line in examples.splitlines())
        parts.append(f"Examples:\n\n```text\n{lines}\n```")
    return "\n\n".join(parts)


def commands_page() -> str:
    """Every command with every option."""
    about = (
        "All of it is also printed by `clt COMMAND --help`. `-h`, `--help` and `--version` are "
        "understood everywhere; [exit codes](../reference.md) are the same for all commands."
    )
    sections = [command_section(name, one) for name, one in load_commands().items()]
    return "\n\n".join(["# Commands", about, *sections])


def key_rows(keys: Iterable[SettingKey]) -> list[tuple[str, str, str, str, str]]:
    """A row for every key."""
    return [
        (
            f"`{key.name}`",
            "-" if key.default is None else f"`{json.dumps(key.default)}`",
            key.unit,
            cell(key.type),
            cell(key.about) or "-",
        )
        for key in keys
    ]


def key_table(model: type[BaseModel], *, nested: bool = True) -> str:
    """The keys of a settings type, those of tables within it unless they stand elsewhere."""
    head = ("key", "default", "unit", "type", "what it is")
    return table(
        head, key_rows(key for key in setting_keys(model) if nested or "." not in key.name)
    )


def settings_page() -> str:
    """Every key of `--set`, of filters and of scenarios."""
    about = (
        "Every key of `--set KEY=VALUE`, of the file given to `--config` and, written as "
        "`CLT_NOISE__SIGMA_RANGE` for `noise.sigma_range`, of the environment. Later ones win: "
        "defaults, scenario or configuration file, environment, options. A default of `-` is "
        "taken from elsewhere, as the last column says, or has to be given. `clt settings` "
        "prints the same."
    )
    return "\n\n".join(
        [
            "# Settings",
            about,
            "## Estimation: `localize`, `init`",
            key_table(FilterSettings),
            "## Scenarios: `simulate`",
            key_table(Scenario),
        ]
    )


def files_page() -> str:
    """The TOML files that commands take."""
    tables: list[tuple[str, type[BaseModel]]] = [
        ("`streams.toml`, top level", StreamsFile),
        ("`streams.toml`, `[robots.NAME]`", RobotStreams),
        ("`streams.toml`, `[[ranges]]`", RangeStreams),
        ("`calibration.toml`, `[range]`", RangeCalibration),
        ("`calibration.toml`, `[[range.pair]]`", PairCalibration),
        ("`calibration.toml`, `[odometry.NAME]`", OdometryCalibration),
        ("`poses.toml`, `[NAME]`", GivenPose),
    ]
    parts = [
        "# Files",
        "The keys of the TOML files that `--streams`, `--calibration` and `--init` take.",
    ]
    for title, model in tables:
        parts += [f"## {title}", key_table(model, nested=False)]
    rows = [(f"`{name}`", cell(one.about)) for name, one in IMPORT_FORMATS.items()]
    parts += ["## Formats of `clt import`", table(("format", "what it reads"), rows)]
    rows = [
        (f"`{path.stem}`", cell(tomllib.loads(path.read_text())["description"]))
        for path in sorted(SCENARIOS.glob("*.toml"))
    ]
    parts += ["## Built-in scenarios", table(("scenario", "what it is"), rows)]
    return "\n\n".join(parts)


def topic_rows() -> list[tuple[str, str, str]]:
    """Every topic that clt writes, its type and what is in it, by the functions that write it."""
    writers: dict[str, tuple[str, Callable[..., object]]] = {
        "odometry": (channels.ODOMETRY_TYPE, channels.odometry_channel),
        "ranges": (channels.RANGE_TYPE, channels.range_channel),
        "frames": (packets.UWB_FRAME_TYPE, packets.packet_channel),
        "truth": (channels.POSE_TYPE, channels.truth_channel),
        "estimate": (channels.ESTIMATE_TYPE, channels.estimate_channel),
        "dead_reckoning": (channels.ESTIMATE_TYPE, channels.estimate_channel),
    }
    found = [(f"/{{robot}}/{leaf}", *writers[role]) for leaf, role in ROLE_BY_LEAF.items()]
    found += [(INNOVATION_TOPIC, channels.INNOVATION_TYPE, channels.innovation_channel)]
    found += [(name, kind, scene.scene_channels) for name, kind in SCENE_TOPICS.items()]
    return [(f"`{name}`", f"`{kind}`", cell(summary(writer))) for name, kind, writer in found]


def summary(writer: Callable[..., object]) -> str:
    """The first line of a docstring, without the topic that the row names already."""
    (line, *_) = str(writer.__doc__).splitlines()
    return re.sub(r"^`[^:]*`: ", "", line)


def topics_page() -> str:
    """Every topic that clt writes, and the types that it reads in other logs."""
    head = ("topic", "type", "content")
    own = "Names and types of what clt writes, and reads without a `streams.toml`."
    foreign = "Types of ranges that a `streams.toml` may name, and the field that holds the range:"
    rows = [(f"`{kind}`", f"`{field}`") for kind, field in RANGE_FIELD_BY_TYPE.items()]
    parts = ["# Topics", own, table(head, topic_rows()), "## Ranges in other logs", foreign]
    return "\n\n".join([*parts, table(("type", "field"), rows)])


def message_section(path: Path) -> str:
    """One message type, as its definition says it."""
    return f"## `{path.parts[-3]}/msg/{path.stem}`\n\n```text\n{path.read_text().strip()}\n```"


def messages_page() -> str:
    """Every message type that is written or read by its definition."""
    found = sorted(
        SCHEMAS.glob("*/msg/*.msg"), key=lambda path: (path.parts[-3] != OWN_MESSAGES, path)
    )
    about = (
        "Definitions as they stand in `schemas/` and in every log. Our own types come first; "
        "all others are those of ROS 2."
    )
    return "\n\n".join(["# Messages", about, *map(message_section, found)])


PAGES = {
    "topics.md": topics_page,
    "commands.md": commands_page,
    "settings.md": settings_page,
    "files.md": files_page,
    "messages.md": messages_page,
}


def main() -> None:
    """Write all pages to the folder given, by default the one of this script."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for name, page in PAGES.items():
        (folder / name).write_text(f"{MADE_BY}\n\n{page()}\n")


if __name__ == "__main__":
    main()
