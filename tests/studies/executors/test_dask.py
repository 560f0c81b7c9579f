"""A Dask cluster on loopback: the same bytes as this process, through deaths."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from clt.core.errors import CltError, UsageError
from clt.studies.executors.dask import run_on_cluster
from clt.studies.executors.here import run_here
from clt.studies.grid import read_study
from clt.studies.sweep import prepare_folder, run_sweep

ROOT = Path(__file__).parents[3]
SWEEP = """
scenario = "shi-sim"
seeds = 6
duration = 3.0
[runs.truth]
init = "truth"
"""
TABLES = ("runs.csv", "summary.csv", "paired.csv")
WAIT_S = 120.0
"""On a machine with much else to do."""


class Cluster:
    """A scheduler and two workers, each a process."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.file = folder / "scheduler.json"
        self.children: list[subprocess.Popen[bytes]] = []

    def start(self) -> str:
        """Start all; returns the address."""
        self.file.unlink(missing_ok=True)
        common = ["--scheduler-file", str(self.file), "--no-dashboard"]
        self._run("scheduler", "--host", "127.0.0.1", "--port", "0", *common)
        deadline = time.monotonic() + WAIT_S
        while not self.file.exists():
            assert time.monotonic() < deadline
            time.sleep(0.1)
        for _ in range(2):
            self._run("worker", "--nthreads", "1", "--no-nanny", *common)
        import distributed  # noqa: PLC0415

        with distributed.Client(scheduler_file=str(self.file), set_as_default=False) as client:
            client.wait_for_workers(2, timeout=WAIT_S)
            address: str = client.scheduler.address
        return address

    def _run(self, *words: str) -> None:
        command = [sys.executable, "-m", "dask", *words, "--local-directory", str(self.folder)]
        if words[0] == "scheduler":
            command = command[:-2]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        with (self.folder / "log").open("ab") as log:
            self.children.append(
                subprocess.Popen(command, env=environment, stdout=log, stderr=log, cwd=self.folder)
            )

    def kill(self, which: int) -> None:
        """Kill the scheduler (0) or a worker."""
        self.children[which].send_signal(signal.SIGKILL)
        self.children[which].wait()

    def stop(self) -> None:
        """End all."""
        for child in self.children:
            child.kill()
            child.wait()
        self.children = []


@pytest.fixture(scope="module")
def cluster(tmp_path_factory) -> Iterator[Cluster]:
    pytest.importorskip("distributed")
    found = Cluster(tmp_path_factory.mktemp("cluster"))
    yield found
    found.stop()


def content(folder):
    return {name: (folder / name).read_bytes() for name in TABLES}


@pytest.mark.filterwarnings("default")  # of Dask's own code
def test_a_cluster_gives_the_same_bytes_whoever_dies(cluster, tmp_path):
    (tmp_path / "sweep.toml").write_text(SWEEP)
    study = read_study(tmp_path / "sweep.toml", {"scenario": {}, "filter": {}})
    here, there = tmp_path / "here", tmp_path / "there"
    prepare_folder(study, here, force=False)
    run_sweep(study, here, run_here, lambda _: None)

    prepare_folder(study, there, force=False)
    address, seen = cluster.start(), []

    def kill_one_worker(progress):
        seen.append(progress.done)
        if progress.done == 1:
            cluster.kill(1)
        if progress.done == 3:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        run_sweep(study, there, partial(run_on_cluster, address=address), kill_one_worker)
    assert seen == [0, 1, 2, 3]
    cluster.stop()

    again = cluster.start()
    run_sweep(study, there, partial(run_on_cluster, address=again), lambda _: None)
    assert content(there) == content(here)
    assert (there / "journal.jsonl").read_text().count("\n") == 6

    lost = tmp_path / "lost"
    prepare_folder(study, lost, force=False)

    def kill_scheduler(progress):
        if progress.done == 1:
            cluster.kill(0)

    with pytest.raises(CltError, match="goes on from here"):
        run_sweep(study, lost, partial(run_on_cluster, address=again), kill_scheduler)


@pytest.mark.filterwarnings("default")  # of Dask's own code
def test_nobody_at_the_address_is_one_line(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("clt.studies.executors.dask.CONNECT_TIMEOUT_S", 0.5)
    with pytest.raises(CltError, match=r"127\.0\.0\.1:9: nobody answers"):
        next(run_on_cluster(str, [1], "tcp://127.0.0.1:9"))
    with pytest.raises(UsageError, match="nonsense"):
        next(run_on_cluster(str, [1], "nonsense://x"))


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"clt\[dask\]"):
        next(run_on_cluster(str, [1], "tcp://127.0.0.1:9"))
