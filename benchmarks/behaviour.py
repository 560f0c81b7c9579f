"""What clt answers, as digests: run before and after a change that must not move a number.

python benchmarks/behaviour.py --out FILE      write one SHA-256 per case
python benchmarks/behaviour.py --against FILE  name every case with another digest

A digest covers every message of a result log (topic, stamps, bytes) and its metadata, or the JSON
of stdout; timings, versions and command lines are left out. `--keep FOLDER` keeps the results, to
see by how much they differ. Each case is a fork of this process, so that imports are paid once.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import os
import pkgutil
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

import clt
from clt.cli import entry

SAMPLES = Path(__file__).parents[1] / "sample_logs"
TIMED = {"timings", "version", "command"}
SEEDS = (11, 12, 13)
RATES = ("--set", "sensors.odometry.rate=20", "--set", "sensors.range.rate=5")
FRAMES = {
    "world": ("eskf", "ekf", "ukf", "pf", "mixture"),
    "ego:R3": ("ekf", "ukf", "pf", "mixture", "dpf"),
    "mutual:R3,R4": ("ekf", "ukf", "pf", "mixture"),
}


def cases() -> list[tuple[str, ...]]:
    """Command lines, in an order in which later ones may use results of earlier ones."""
    seeded = [f"shi-{seed}.mcap" for seed in SEEDS]
    logs = [sample.name for sample in sorted(SAMPLES.glob("*.mcap"))] + seeded
    made: list[tuple[str, ...]] = [
        *(
            ("simulate", "shi-sim", "--seed", f"{seed}", "--duration", "20", *RATES, "-o", log)
            for seed, log in zip(SEEDS, seeded, strict=True)
        )
    ]
    for log in logs:
        for frame, filters in FRAMES.items():
            made.extend(localize(log, name, frame) for name in filters)
        made.append(localize(log, "eskf", "world", "--as-received"))
        made.extend(localize(log, name, "world", "--engine", "filterpy") for name in ("ekf", "ukf"))
        made.append(("init", log, "--json"))
        made.append(("init", log, "--json", "--method", "pairwise"))
        made.append(("observability", log, "--json"))
    made.extend(("evaluate", case[-1], "--json") for case in [*made] if case[0] == "localize")
    for seed in SEEDS:
        raw = f"raw-{seed}.mcap"
        made.append(
            (
                *("simulate", "shi-five", "--seed", f"{seed}", "--duration", "10"),
                *("--set", "radio={}", "-o", raw),
            )
        )
        made.append(("range", raw, "-o", f"ranged-{seed}.mcap"))
        made.append(("simulate", "li-two", "--seed", f"{seed}", "-o", f"li-{seed}.mcap"))
        made.append(("init", f"li-{seed}.mcap", "--json", "--method", "pairwise"))
        made.append(localize(f"li-{seed}.mcap", "dpf", "ego:R1", start="auto"))
    return made


def localize(log: str, name: str, frame: str, *more: str, start: str = "truth") -> tuple[str, ...]:
    """One run; its result is named after what was asked."""
    words = [Path(log).stem, name, frame, *more]
    result = "-".join(w.strip("-").translate(str.maketrans(":,", "--")) for w in words) + ".mcap"
    options = ("--filter", name, "--frame", frame, "--init", start, *more)
    particles = ("--set", "pf.particles=500") if name == "pf" else ()
    return ("localize", log, *options, *particles, "-o", result)


def digest_of_log(path: Path) -> str:
    """SHA-256 of everything in a log but timings and versions."""
    seen = hashlib.sha256()
    with path.open("rb") as file:
        reader = make_reader(file)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            kind = "" if schema is None else schema.name
            words = (channel.topic, kind, message.log_time, message.publish_time)
            seen.update(repr(words).encode())
            seen.update(message.data)
        for record in reader.iter_metadata():
            seen.update(repr((record.name, plain(dict(record.metadata)))).encode())
    return seen.hexdigest()


def plain(value: Any) -> Any:
    """A value without timings, versions and commands, with its texts of JSON taken apart."""
    match value:
        case dict():
            return {k: plain(v) for k, v in sorted(value.items()) if k not in TIMED}
        case list():
            return [plain(v) for v in value]
        case str() if value[:1] in {"{", "["}:
            try:
                return plain(json.loads(value))
            except json.JSONDecodeError:
                return value
    return value


def run(case: tuple[str, ...], folder: Path) -> str:
    """Run one case in a fork and return its exit code and the digest of what it made."""
    said = folder / ("_".join(case).replace("/", "-") + ".out")
    child = os.fork()
    if child == 0:
        os.chdir(folder)
        os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 1)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        sys.argv = ["clt", *case]
        try:
            entry.main()
        except SystemExit as end:
            sys.stdout.flush()
            os._exit(end.code if isinstance(end.code, int) else 1)
        finally:  # the scratch folder is the parent's
            os._exit(1)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if "-o" in case:
        path = folder / case[case.index("-o") + 1]
        return f"{code} {digest_of_log(path) if path.exists() else 'nothing'}"
    text = said.read_text()
    plainly = json.dumps(plain(json.loads(text))) if text else "nothing"
    return f"{code} {hashlib.sha256(plainly.encode()).hexdigest()}"


def import_all() -> None:
    """Import every module of clt, so that forks need not."""
    for module in pkgutil.walk_packages(clt.__path__, "clt."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)


def main() -> int:
    """Write digests, or compare with those of an earlier run; 1 where one differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--keep", type=Path)
    args = parser.parse_args()
    before = {}
    if args.against is not None:
        lines = args.against.read_text().splitlines()
        before = {case: digest for digest, _, case in (line.partition("  ") for line in lines)}
    import_all()
    lines, different = [], 0
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) if args.keep is None else args.keep
        folder.mkdir(parents=True, exist_ok=True)
        for sample in SAMPLES.glob("*.mcap"):
            shutil.copy(sample, folder)
        for case in cases():
            name, found = " ".join(case), run(case, folder)
            lines.append(f"{found}  {name}")
            if args.against is not None and before.get(name) != found:
                different += 1
                print(f"another digest: clt {name}", flush=True)
    if args.out is not None:
        args.out.write_text("\n".join(lines) + "\n")
    print(f"{len(lines)} cases, {different} different")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
