"""Hostile values for every key of `--set`, of files, of the environment and of scenarios.

Run: python -m tests.fuzz.settings --count N [--seed S] [--only NUMBER]. Every finding is printed
with its number, which `--only` repeats alone. Exit code 1 when there is one.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from pathlib import Path
from random import Random

from clt.cli.common import read_filter_settings
from clt.core.document import Document
from clt.core.errors import UsageError
from clt.core.settings import Settings, known_keys, parse_assignments, settings_from_environment
from clt.model.settings import FilterSettings
from clt.sim.scenario import Scenario, load_scenario
from tests.fuzz.oracle import run

VALUES = (
    "0", "-0.0", "-1", "1", "0.5", "1e300", "-1e300", "1e-300", "5e-324", "nan", "inf", "-inf",
    "true", "false", "word", "''", '""', "''''''", "[]", "[[]]", "[1]", "[1, 2, 3]", "[1, 'a']",
    "{}", "{ x = 1 }", "{ kind = 'wander' }", "[nan, 1, 1]", "[1e300, 1, 1]", "1979-05-27",
    "07:32:00", "9223372036854775807", "9223372036854775808", "-9223372036854775809", "1_000",
    "0x10", "1e400", "1" + 400 * "0", 5000 * "9", 200 * "[" + 200 * "]", 3000 * "[" + 3000 * "]",
    "R1-R2", "all", "none", "\x1b[2J", "a\nb = 1", "1 # c", "\u0661", "\ud800", 10_000 * "x", "",
    "[['R1', 'R2']]", "[{ name = 'R1' }, { name = 'R1' }]",
    "[{ duration = 1, v = 1e300, omega = 1 }]",
)  # fmt: skip
SHORT = ["--set", "duration=0.5", "--set", "team.moving=2", "--set", "team.static=2"]
COSTLY = ("rate", "moving", "static", "duration", "particles", "gaussians", "iterations")
"""Keys of honest amounts of work: whole commands do not take them."""


def key_of(model: type[Settings], rng: Random) -> str:
    """A key, or nearly one."""
    key = rng.choice(known_keys(model))
    if rng.random() < 0.1:
        place = rng.randrange(len(key) + 1)
        key = key[:place] + rng.choice([".", "", "x", "..", " ", "=", "\n", "\x1b"]) + key[place:]
    return key


def parsed(rng: Random, folder: Path) -> list[str]:
    """Read settings only: a refusal is one line, what is accepted is finite."""
    model = rng.choice([FilterSettings, Scenario])
    key, value = key_of(model, rng), rng.choice(VALUES)
    way = rng.choice(["set", "file", "environment"])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            if way == "set":
                options = parse_assignments([f"{key}={value}"])
                if model is FilterSettings:
                    read_filter_settings(None, [f"{key}={value}"])
                else:
                    load_scenario("shi-sim", options)
            elif way == "file":
                text = f"{key} = {value}\n".encode(errors="replace")
                document = Document(folder / "a.toml", text)
                if model is FilterSettings:
                    read_filter_settings(document, [])
                else:
                    load_scenario(document)
            else:
                name = "CLT_" + key.replace(".", "__").upper()
                found = settings_from_environment(model, {name: value})
                if model is Scenario:
                    load_scenario("shi-sim", environment=found)
    except UsageError as error:
        text = str(error)
        wrong = [f"says {text!r}"] if len(text) > 400 or "Input should" in text else []
    except Exception as error:  # noqa: BLE001 - that is what is looked for
        wrong = [f"{type(error).__name__}: {error}"]
    else:
        wrong = []
    return [f"{way} {key!r} = {value[:60]!r}: {text[:300]}" for text in wrong]


def commanded(rng: Random, log: Path) -> list[str]:
    """A whole command that takes the value, or refuses it."""
    model, out = rng.choice([FilterSettings, Scenario]), log.with_name("out.mcap")
    key = rng.choice([key for key in known_keys(model) if key.split(".")[-1] not in COSTLY])
    value = rng.choice([value for value in VALUES if "\0" not in value and "\ud800" not in value])
    if model is Scenario:
        words = ["simulate", rng.choice(["shi-sim", "freeman"]), *SHORT]
    else:
        words = ["localize", str(log), "--init", "truth"]
        words += ["--filter", rng.choice(["eskf", "ekf", "ukf"])]
    words += ["-o", str(out), "--force", "--set", f"{key}={value}"]
    wrong = run(words, out)
    out.unlink(missing_ok=True)
    return [f"clt {' '.join(words[:2])} --set {key}={value[:60]!r}: {text}" for text in wrong]


def case(number: int, seed: int, folder: Path) -> list[str]:
    """One value, mostly only parsed; what is wrong."""
    rng = Random(f"{seed} {number}")
    log = folder / "log.mcap"
    if not log.exists():
        assert run(["simulate", "shi-sim", *SHORT, "-o", str(log)]) == []
    found = commanded(rng, log) if rng.random() < 0.08 else parsed(rng, folder)
    return [f"{number}: {line}" for line in found]


def study(count: int, seed: int, folder: Path) -> list[str]:
    """So many cases; every finding in a line."""
    return [line for number in range(count) for line in case(number, seed, folder)]


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, help="number of a case to repeat")
    given = parser.parse_args()
    numbers = range(given.count) if given.only is None else [given.only]
    found = 0
    with tempfile.TemporaryDirectory() as place:
        for number in numbers:
            for line in case(number, given.seed, Path(place)):
                found += 1
                print(line, flush=True)
            if number % 1000 == 999:
                print(f"{number + 1} done", file=sys.stderr)
    print(f"{found} findings in {len(numbers)} settings, seed {given.seed}")
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
