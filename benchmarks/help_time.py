"""What `clt --help` costs beside a trivial typer application, each a whole process.

Run: python benchmarks/help_time.py [--runs 40]. Both take the same interpreter and run by turns,
so that a busy machine slows both; the table shows medians and the ratio of each pair's medians.
Exit code 1 when the ratio exceeds the target.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

TARGET = 1.3
TRIVIAL = """
import typer

app = typer.Typer()


@app.command()
def hello(name: str = "world") -> None:
    print(f"hello {name}")


@app.command()
def bye(name: str = "world") -> None:
    print(f"bye {name}")


app()
"""


def seconds(command: list[str]) -> float:
    """Wall-clock time of one process."""
    start = time.perf_counter()
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - start


def measure(runs: int) -> tuple[list[float], list[float]]:
    """Times (s) of the trivial application and of clt, in turn; the first of each is dropped."""
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "trivial.py"
        script.write_text(TRIVIAL, encoding="utf-8")
        trivial = [sys.executable, str(script), "--help"]
        clt = [sys.executable, "-m", "clt", "--help"]
        pairs = [(seconds(trivial), seconds(clt)) for _ in range(runs + 1)][1:]
    return [a for a, _ in pairs], [b for _, b in pairs]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=40, help="pairs of runs")
    trivial, clt = measure(parser.parse_args().runs)
    a, b = statistics.median(trivial), statistics.median(clt)
    print("| program | median, ms | fastest, ms |")
    print("|---|---|---|")
    print(f"| trivial typer application `--help` | {1e3 * a:.0f} | {1e3 * min(trivial):.0f} |")
    print(f"| `clt --help` | {1e3 * b:.0f} | {1e3 * min(clt):.0f} |")
    print(f"| ratio (target <= {TARGET}) | {b / a:.2f} | {min(clt) / min(trivial):.2f} |")
    return int(b / a > TARGET)


if __name__ == "__main__":
    sys.exit(main())
