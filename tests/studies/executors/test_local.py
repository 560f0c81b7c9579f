"""Worker processes: order, deaths, and what a death costs."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from clt.core.errors import CltError
from clt.studies.executors import WorkerLost, local
from clt.studies.executors.here import run_here
from clt.studies.executors.local import run_local

WORK = "tests_executors_work"
CODE = """
import os, signal, time
from pathlib import Path

def square(n):
    return n * n

def dies_once(item):
    folder, n = item
    mark = Path(folder) / str(n)
    if n == 2 and not mark.exists():
        mark.write_text("")
        os.kill(os.getpid(), signal.SIGKILL)
    with (Path(folder) / "done").open("a") as file:
        file.write(f"{n}\\n")
    return n

def dies_on_two(n):
    if n == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return n

def dies(n):
    os.kill(os.getpid(), signal.SIGKILL)

def threads(_):
    from threadpoolctl import threadpool_info
    import scipy.linalg
    return max((one["num_threads"] for one in threadpool_info()), default=1)
"""


@pytest.fixture
def work(tmp_path, monkeypatch):
    """A module that workers can import."""
    (tmp_path / f"{WORK}.py").write_text(CODE)
    monkeypatch.syspath_prepend(str(tmp_path))
    return __import__(WORK)


def test_one_process_does_one_item_after_another():
    assert list(run_here(str, [1, 2])) == [(1, "1"), (2, "2")]


def test_a_dead_worker_costs_its_own_item_which_is_done_again(work, tmp_path):
    items = [(str(tmp_path), n) for n in range(4)]
    found = dict(run_local(work.dies_once, items, 2))
    assert found == {item: item[1] for item in items}
    assert sorted((tmp_path / "done").read_text().split()) == ["0", "1", "2", "3"]


def test_an_item_that_kills_every_worker_is_given_up_and_the_rest_goes_on(work):
    found = dict(run_local(work.dies_on_two, range(4), 1))
    assert isinstance(found.pop(2), WorkerLost)
    assert found == {0: 0, 1: 1, 3: 3}


def test_workers_that_always_die_end_the_work(work):
    with pytest.raises(CltError, match="workers die at once"):
        list(run_local(work.dies, range(9), 1))


def test_workers_use_one_thread_for_algebra(work):
    assert dict(run_local(work.threads, [0], 1)) == {0: 1}


def test_the_first_item_may_go_alone(work, monkeypatch):
    made = []
    real = local.new_worker
    monkeypatch.setattr(local, "new_worker", lambda: made.append(0) or real())
    results = run_local(work.square, range(3), 2, first_alone=True)
    assert next(results) == (0, 0)
    assert len(made) == 1
    assert dict(results) == {1: 1, 2: 4}


PARENT = """
import sys, time
from clt.studies.executors.local import run_local
sys.path.insert(0, sys.argv[1])
if __name__ == "__main__":
    import sleeper
    list(run_local(sleeper.sleep, range(2), 2))
"""
SLEEPER = """
import os, time
from pathlib import Path
def sleep(n):
    Path(__file__).with_name(f"pid{n}").write_text(str(os.getpid()))
    time.sleep(600)
"""


def test_workers_end_with_a_parent_that_is_killed(tmp_path):
    import subprocess  # noqa: PLC0415
    import sys  # noqa: PLC0415

    (tmp_path / "sleeper.py").write_text(SLEEPER)
    (tmp_path / "parent.py").write_text(PARENT)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(Path.cwd())])}
    words = [sys.executable, str(tmp_path / "parent.py"), str(tmp_path)]
    parent = subprocess.Popen(words, env=environment)
    files = [tmp_path / "pid0", tmp_path / "pid1"]
    while not all(file.exists() and file.read_text() != "" for file in files):
        assert parent.poll() is None
        time.sleep(0.05)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    workers = [int(file.read_text()) for file in files]
    deadline = time.monotonic() + 60.0
    while any(map(alive, workers)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(alive, workers))


def alive(pid):
    """Whether a process runs; one that nobody waits for does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"
