"""Processor time of short commands beside evo on the same result, as ratios measured in one run.

    python benchmarks/startup.py [--evo ~/evo/bin/evo_ape] [--runs 7] [--out FILE]

`clt localize --filter eskf --init truth` of 60 s of shi-sim, `clt evaluate` and `clt info` on its
result, and `evo_ape mcap` on one trajectory of it take turns; so do `clt localize` of 300 s with
all pairs at 100 Hz and the official reader, which does nothing but iterate that log's messages.
Warm: each runs once before. The least of all runs counts, which other work disturbs least.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from processes import CLT, iterating, spent
from report import publish

LARGE = ("--set", "sensors.range.rate=100")


def least(commands: dict[str, tuple[str, ...]], runs: int) -> dict[str, float]:
    """Least processor time of each command, s, after a first run that warms up."""
    times: dict[str, list[float]] = {name: [] for name in commands}
    for _ in range(runs + 1):
        for name, command in commands.items():
            times[name].append(spent(*command))
    return {name: min(each[1:]) for name, each in times.items()}


def localizing(log: str, out: str) -> tuple[str, ...]:
    """The command that localizes a log."""
    words = ("localize", log, "--filter", "eskf", "--init", "truth", "-q", "--force", "-o", out)
    return *CLT, *words


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--evo", default="~/evo/bin/evo_ape")
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    evo = str(Path(options.evo).expanduser())
    with tempfile.TemporaryDirectory() as folder:
        log, out, large = (f"{folder}/{name}.mcap" for name in ("log", "out", "large"))
        spent(*CLT, "simulate", "shi-sim", "--duration", "60", "-q", "-o", log)
        spent(*CLT, "simulate", "shi-sim", *LARGE, "-q", "-o", large)
        commands = {
            "`clt localize`": localizing(log, out),
            "`clt evaluate`": (*CLT, "evaluate", out),
            "`clt info`": (*CLT, "info", out),
            "`evo_ape mcap`": (evo, "mcap", out, "/R3/ground_truth", "/R3/estimate"),
        }
        short = least(commands, options.runs)
        pair = {"ours": localizing(large, f"{folder}/o.mcap"), "theirs": iterating(large)}
        long = least(pair, max(options.runs // 2, 1))
    beside = short["`evo_ape mcap`"]
    rows = [f"| {name}, 60 s | {t:.2f} s | {t / beside:.2f} |" for name, t in short.items()]
    ratio = long["ours"] / long["theirs"]
    publish(
        [
            "Processor time in one run (`python benchmarks/startup.py`), beside evo's on the same",
            "result and, for 300 s at 100 Hz, beside iterating the log by the official reader:",
            "",
            "| what | processor time | ratio |",
            "|---|---|---|",
            *rows,
            f"| `clt localize`, 100 Hz, 300 s | {long['ours']:.2f} s | {ratio:.2f} |",
            f"| iterating by mcap | {long['theirs']:.2f} s | 1.00 |",
        ],
        options.out,
    )


if __name__ == "__main__":
    main()
