"""What a study costs: against a shell loop of three commands, through kills, and its tables.

    python benchmarks/studies.py --runs 1000 --kills 20 --out benchmarks/results/studies.md

Processor time is that of all processes, user and system, measured in one run of this script; the
shell loop is done `--shell` times. Kernels are compiled before anything is measured.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from clt.studies.executors.local import run_local
from clt.studies.grid import read_study
from clt.studies.journal import Journal
from clt.studies.sweep import JOURNAL, Progress, prepare_folder, run_sweep, write_tables
from clt.studies.task import SCORES, RunOutcome

CLT = [sys.executable, "-m", "clt"]
TABLES = ("runs.csv", "summary.csv", "paired.csv")
NOTHING = {"scenario": {}, "filter": {}}
STUDY = 'scenario = "shi-sim"\nseeds = {runs}\nduration = {seconds}\n[runs.eskf]\ninit = "{init}"\n'


def processor_time() -> float:
    """Of this process and all that it waited for, s."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def clt(*words: object) -> None:
    """Run a command; exit code 3 is a result, too."""
    code = subprocess.run(
        [*CLT, *map(str, words), "-q"], stdout=subprocess.DEVNULL, check=False
    ).returncode
    if code not in {0, 3}:
        raise SystemExit(f"clt {words}: exit code {code}")


def shell_loop(folder: Path, count: int, init: str) -> float:
    """Processor time of one run through three commands, s."""
    log, out = folder / "log.mcap", folder / "out.mcap"
    begin = processor_time()
    for seed in range(1, count + 1):
        clt("simulate", "shi-sim", "--duration", 60, "--seed", seed, "-o", log, "--force")
        clt("localize", log, "--init", init, "-o", out, "--force")
        clt("evaluate", out, "--json")
    return (processor_time() - begin) / count


def study_file(folder: Path, runs: int, seconds: float, init: str) -> Path:
    """A sweep file of shi-sim."""
    path = folder / f"study-{runs}-{seconds:g}-{init}.toml"
    path.write_text(STUDY.format(runs=runs, seconds=seconds, init=init))
    return path


def sweep(folder: Path, runs: int, init: str, jobs: int) -> float:
    """Processor time of one run of a study, start of the program and tables included, s."""
    path = study_file(folder, runs, 60.0, init)
    begin = processor_time()
    clt("sweep", path, "-o", folder / f"out-{init}-{jobs}", "--jobs", jobs)
    return (processor_time() - begin) / runs


def kills(folder: Path, count: int, seed: int) -> tuple[int, bool]:
    """How often a study was killed at random moments, and whether its tables are the same."""
    path = study_file(folder, 40, 10.0, "truth")
    clt("sweep", path, "-o", folder / "whole")
    draw, killed = random.Random(seed), 0
    longest = 3.0
    while killed < count:
        command = [*CLT, "sweep", str(path), "-o", str(folder / "killed"), "-q", "--jobs", "2"]
        child = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL)
        try:
            child.wait(timeout=draw.uniform(0.2, longest))
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()
            killed += 1
        else:
            break
    clt("sweep", path, "-o", folder / "killed")
    same = all(
        (folder / "whole" / name).read_bytes() == (folder / "killed" / name).read_bytes()
        for name in TABLES
    )
    return killed, same


def summary_seconds(folder: Path, rows: int) -> float:
    """Wall-clock time that the tables of so many made-up rows take, s."""
    study = read_study(study_file(folder, rows, 60.0, "truth"), NOTHING)
    out = folder / "rows"
    prepare_folder(study, out, force=True)
    draw = random.Random(1)
    with Journal(out / JOURNAL) as journal:
        digests = [task.digest for task in study.tasks()]
        for digest in digests:
            scores = {name: draw.random() for name in SCORES}
            seconds = {"simulate": 0.1, "localize": 0.1, "evaluate": 0.1}
            journal.add(digest, [RunOutcome(0, diverged=False, scores=scores, seconds=seconds)])
        begin = time.perf_counter()
        write_tables(study, out, journal, digests, Progress(rows))
        return time.perf_counter() - begin


def memory_growth(folder: Path, runs: int) -> tuple[float, float]:
    """Peak memory of a parent after a tenth of the tasks and after all, MB."""
    study = read_study(study_file(folder, runs, 1.0, "truth"), NOTHING)
    out = folder / "memory"
    prepare_folder(study, out, force=True)
    peaks: list[float] = []

    def note(_: Progress) -> None:
        peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)

    run_sweep(study, out, partial(run_local, jobs=2), note)
    return peaks[len(peaks) // 10], peaks[-1]


def main() -> None:
    """Measure and print, or write, one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--shell", type=int, default=10)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--rows", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    lines = ["| what | value |", "|---|---|"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for init in ("auto", "truth"):
            shell_loop(folder, 1, init)
            loop = shell_loop(folder, given.shell, init)
            study = sweep(folder, given.runs, init, 1)
            lines += [
                f"| shell loop, `--init {init}`: processor time per run | {loop:.2f} s |",
                f"| study of {given.runs} runs, `--init {init}`: the same | {study:.3f} s |",
                f"| ratio, `--init {init}` | {loop / study:.1f} |",
            ]
        killed, same = kills(folder, given.kills, given.seed)
        lines.append(f"| tables after {killed} kills | {'the same bytes' if same else 'DIFFER'} |")
        lines.append(
            f"| tables of {given.rows} rows | {summary_seconds(folder, given.rows):.2f} s |"
        )
        early, late = memory_growth(folder, max(given.runs // 4, 20))
        lines.append(f"| parent after a tenth and all | {early:.0f}, {late:.0f} MB |")
    text = "\n".join(lines) + "\n"
    print(text)
    if given.out is not None:
        given.out.write_text(text)


if __name__ == "__main__":
    main()
