"""Whole commands on hostile logs.

Run: python -m tests.fuzz.commands --count N [--seed S] [--only NUMBER]. Every finding is printed
with its number, which `--only` repeats alone, leaving the log at `hostile.mcap`. Exit code 1 when
there is one.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from functools import cache
from pathlib import Path
from random import Random

from clt.log.recording.load import load
from tests.fuzz.hostile import hostile
from tests.fuzz.oracle import run

FILTERS = ("eskf", "eskf", "ekf", "ukf", "mixture", "pf", "dpf")
SHARES = {
    "localize": 10, "info": 3, "init": 4, "evaluate": 3, "observability": 2, "range": 2,
    "recover": 1, "plot": 1,
}  # fmt: skip


@cache
def result(folder: Path) -> bytes:
    """A result log."""
    log, out = folder / "honest.mcap", folder / "result.mcap"
    words = ["simulate", "shi-sim", "--duration", "4", "-o", str(log), "--force"]
    assert run(words) == []
    assert run(["localize", str(log), "-o", str(out), "--force", "--init", "truth"], out) == []
    return out.read_bytes()


def words_of(command: str, log: str, out: Path, rng: Random) -> list[str]:
    """A command line about a log."""
    names = ("R1", "R2", "R3", "S1", "car1", "A1")
    words = [command, log]
    if command == "localize":
        frame = rng.choice(["world", "world", f"ego:{rng.choice(names)}", "mutual:R1,R2"])
        chosen = rng.choice(FILTERS)
        words += ["--init", rng.choice(["truth", "truth", "auto", "motion", "pairwise"])]
        words += ["--frame", frame, "--filter", chosen, "-o", str(out), "--force"]
        words += ["--set", "pf.particles=200", "--set", "dpf.particles=50"]
        words += ["--set", "pf.gaussians=20", "--set", "mixture.components=20"]
        words += ["--as-received"] if rng.random() < 0.3 else []
        words += rng.choice([[], [], ["--set", "noise.scale=0.05", "--set", "noise.bias=0.02"]])
    elif command == "init":
        words += ["--method", rng.choice(["auto", "motion", "pairwise", "truth"])]
    elif command in {"range", "recover"}:
        words += ["-o", str(out), "--force"]
    elif command == "plot":
        words += ["-o", str(out.with_suffix(".svg")), "--force"]
    elif command == "evaluate":
        words += rng.choice([[], ["--align", "se2"], ["--align", "anchors"], ["--delta", "1m"]])
    elif command == "observability":
        words += rng.choice([[], ["--frame", "ego"], ["--window", "1"]])
    return words + (["--json"] if command != "plot" and rng.random() < 0.5 else [])


def case(number: int, seed: int, folder: Path) -> list[str]:
    """One command on one log; what is wrong with how it ends."""
    rng = Random(f"{seed} {number}")
    (command,) = rng.choices(list(SHARES), list(SHARES.values()))
    honest = None
    if command in {"evaluate", "plot"} or rng.random() < 0.1:
        (folder / "result.mcap").write_bytes(result(folder))
        honest = load(folder / "result.mcap").recording
    log, out = folder / "hostile.mcap", folder / "out.mcap"
    log.write_bytes(hostile(rng, honest))
    words = words_of(command, str(log), out, rng)
    wrong = run(words, out)
    out.unlink(missing_ok=True)
    line = " ".join(words).replace(f"{folder}/", "")
    return [f"{number}: clt {line}: {text}" for text in wrong]


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
    if given.only is not None:
        findings = case(given.only, given.seed, Path())
        print(*findings, sep="\n")
        return int(len(findings) > 0)
    found = 0
    with tempfile.TemporaryDirectory() as place:
        for number in range(given.count):
            for line in case(number, given.seed, Path(place)):
                found += 1
                print(line, flush=True)
            if number % 1000 == 999:
                print(f"{number + 1} done", file=sys.stderr)
    print(f"{found} findings in {given.count} commands, seed {given.seed}")
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
