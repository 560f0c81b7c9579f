"""Every kind of diagnostic has words, and words stand nowhere else."""

import ast
import json
import math
import re
from pathlib import Path
from string import Formatter

import pytest

from clt.cli.console import EXIT_DONE, EXIT_PARTIAL, Console
from clt.cli.initial import warn_uncertain_robots
from clt.cli.messages.causes import CAUSE_TEXTS, cause_text
from clt.cli.messages.faults import fault_diagnostic
from clt.cli.messages.initialization import REASONS, reason_text
from clt.cli.messages.render import TEXTS, diagnostic_document, diagnostic_text
from clt.core import diagnostics
from clt.core.diagnostics import DIVERGED, Diagnostic, by_severity
from clt.core.recording import Fault
from clt.initialization.status import Initialization, RobotStatus, unobservable_status

PACKAGE = Path(diagnostics.__file__).parents[1]
ALGORITHMS = (
    "calibration", "core", "devices", "estimation", "filters", "initialization", "jit", "metrics",
    "model", "observability", "ranging", "sim",
)  # fmt: skip
OPTION = re.compile(r"(?<![\w-])--[a-z]")
PAIR = {
    "pair": "R1-R2", "count": 90, "rejected_share": 0.26, "mean_m": 0.314,
    "autocorrelation": 0.5, "mean_nis": 3.25,
}  # fmt: skip
MISFIT = {
    "filter": "eskf", "mean_nis": 2.25, "mean_nis_by_chance": 1.11, "scattered": True,
    "pairs": [PAIR], "frozen": [], "vague": False, "cause": None, "decided": False,
}  # fmt: skip
OFFSET = {"kind": "offset", "robots": ["R1", "R2"], "value": 0.5, "place_m": None}
VALUES = {
    "noise_estimated": {
        "noise": {"slow": 0.1, "sigma_range": None, "outliers.isolated": 0.02},
        "runs": 9,
    },
    "fixed_ranges": {"count": 2},
    "ranges_contradict": {"pair": "R1-R2"},
    "ranges_biased": {"pairs": "R1-R2 or R1-R3", "cause": OFFSET},
    "start_misfit": {"mean_nis": 3.0},
    "misfit": MISFIT,
    "idle_static_robots": {"robots": ["R1", "R2", "R3", "R4"]},
    "implausible_odometry_error": {"what": "bias", "value": 0.3, "sigmas": 5.0},
    "unobservable": {"directions": ["heading of R1"], "remedies": ["let it drive"]},
    "worse_than_dead_reckoning": {
        "rmse_m": 1.0, "dead_reckoning_rmse_m": 0.5, "inside_share": 0.25,
    },
    "open_pair_pose": {
        "count": 2, "probability": 0.75, "sigma_m": 0.5, "sigma_heading": 0.25, "observable": True,
        "span_s": 60,
    },
    "robot_found": {"times": 1, "in_vain": 2},
    "search_in_vain": {"times": 2},
    "mirrored": {"robots": 1},
    "left_out": {"counts": {"no_id": 3, "too_old": 1}},
    "not_reported": {"counts": {"truth": 5}},
    "nothing_decoded": {"bytes": 2000, "proto": "rcl"},
    "unknown_ids": {"counts": {"7": 12}},
    "robots_named": {"names": {"0": "n0"}},
    "source_damaged": {
        "lost": 3, "bad_frames": 0, "damaged_bytes": 0, "undecoded_bytes": 0, "reconnects": 1,
    },
}  # fmt: skip
"""Of the kinds whose text is a function."""


def sources(*rooms):
    for room in rooms:
        for path in sorted((PACKAGE / room).rglob("*.py")):
            yield path, ast.parse(path.read_text())


def constants(tree):
    """The string constants of module level, by name, those of tuples included."""
    found = {}
    for node in tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple | ast.Name):
            target, value = node.targets[0], node.value
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            values = value.elts if isinstance(value, ast.Tuple) else [value]
            found |= {
                n.id: v.value
                for n, v in zip(names, values, strict=False)
                if isinstance(v, ast.Constant)
            }
    return found


def kinds_in_code():
    """The kind of every diagnostic that is made anywhere, but for those of faults."""
    kinds = set()
    for path, tree in sources("."):
        known = {"DIVERGED": DIVERGED, **constants(tree)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Diagnostic":
                kind = node.args[0]
                if path.name == "faults.py":
                    continue
                kinds.add(kind.value if isinstance(kind, ast.Constant) else known[kind.id])
    return kinds


def words_of(template):
    return {name for _, name, _, _ in Formatter().parse(template) if name}


def test_every_kind_that_is_made_has_a_text_and_every_text_a_kind():
    assert kinds_in_code() == set(TEXTS)


@pytest.mark.parametrize("kind", sorted(TEXTS))
def test_every_kind_renders_to_one_line(kind):
    text = REASONS.get(kind, TEXTS[kind])
    values = VALUES.get(kind, {})
    if isinstance(text, str):
        values = {name: "R9" if name in STRINGS else 2.0 for name in words_of(text)}
    given = {"status": "ambiguous", **values} if kind in REASONS else values
    line = diagnostic_text(Diagnostic(kind, "R7", "partial", given))
    assert "\n" not in line
    assert "{" not in line
    assert "R7" in line or not (isinstance(text, str) and "{subject}" in text)
    assert all(name in line for name in ("R7 (ambiguous): ",) if kind in REASONS)


STRINGS = {
    "anchors", "ego", "error", "filter", "frames", "pair", "pairs", "reference", "robots", "static",
    "status", "stream", "text", "what", "why",
    "proto",
}  # fmt: skip


@pytest.mark.parametrize("kind", sorted(CAUSE_TEXTS))
def test_every_cause_renders(kind):
    line = cause_text({"kind": kind, "robots": ["R1", "R2"], "value": 0.5, "place_m": [1.0, 2.0]})
    assert re.search(r"R1|noise|all ranges", line)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "mean NIS 2.25, at most 1.11 by chance"),
        ({}, "R1-R2: 26 % of 90 rejected, mean residual +0.314 m, correlation in time 0.50, "),
        ({}, "cause unknown: see noise.sigma_range"),
        ({"filter": "pf"}, "or pf.particles are too few"),
        ({"pairs": [PAIR] * 3}, "so does 1 more pair;"),
        ({"pairs": [PAIR] * 4}, "so do 2 more pairs;"),
        ({"pairs": [PAIR | {"mean_m": math.nan}]}, "26 % of 90 rejected;"),
        ({"pairs": [PAIR | {"autocorrelation": math.nan}]}, "+0.314 m, mean NIS 3.25"),
        ({"vague": True}, "too uncertain for a filter with one Gaussian (--filter mixture)"),
        ({"cause": OFFSET}, "likely cause: the ranges R1-R2 are 0.50 m too long"),
        ({"decided": True}, "covariances are too small, and what became unique may be wrong"),
        ({"scattered": False, "pairs": []}, "ranges and odometry do not fit each other; "),
        (
            {"frozen": [{"pair": "R1-R3", "range_m": 2.5, "count": 12, "moved_m": 1.25}]},
            "(2.500 m repeated 12 times while the estimated distance changed by 1.25 m): look at",
        ),
    ],
)
def test_a_misfit_in_words(change, words):
    assert words in diagnostic_text(Diagnostic("misfit", values=MISFIT | change))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "2 poses explain the ranges (this one with probability 0.750); let both robots drive"),
        ({"count": 1}, "its pose is known only to 0.50 m and 0.25 rad; let both robots drive in"),
        ({"observable": False}, "probability 0.750): not observable yet; let both robots drive in"),
        ({}, "drive in curves in the first 60 s, or state the noise"),
    ],
)
def test_an_open_pair_in_words(change, words):
    why = Diagnostic("open_pair_pose", values=VALUES["open_pair_pose"] | change)
    assert words in reason_text(why)


def test_a_certain_robot_needs_no_reason():
    assert reason_text(None) == ""


def test_robots_that_share_a_reason_are_named_together():
    why = [Diagnostic("moved_too_little", values={"moved_m": m}) for m in (0.1, 0.1, 0.2)]
    robots = {f"R{k}": unobservable_status(one) for k, one in enumerate(why)}
    console = Console(quiet=True)
    warn_uncertain_robots(Initialization(0, True, robots), console)
    assert [one["subject"] for one in console.diagnostics] == ["R0, R1", "R2"]
    assert console.diagnostics[0]["kind"] == "moved_too_little"
    assert console.warnings[0].startswith("R0, R1 (unobservable): it has moved too little (0.10 m)")
    assert console.code == EXIT_PARTIAL


def test_a_robot_whose_hypotheses_are_kept_is_only_a_warning():
    why = Diagnostic("open_pair_pose", values=VALUES["open_pair_pose"])
    found = Initialization(0, True, {"R1": RobotStatus("ambiguous", None, why=why, open=True)})
    console = Console(quiet=True)
    warn_uncertain_robots(found, console, kept=True)
    assert [one["severity"] for one in console.diagnostics] == ["warning"]
    assert console.code == EXIT_DONE


def test_lists_are_shortened_with_a_count():
    few = Diagnostic("idle_static_robots", values={"robots": ["A", "B", "C", "D", "E"]})
    assert "no range touches A, B, C and 2 more:" in diagnostic_text(few)
    directions = {"directions": list("abcde"), "remedies": []}
    line = diagnostic_text(Diagnostic("unobservable", values=directions))
    assert line == "ranges cannot observe a, b, c, d and 1 more: such errors never shrink"


def test_a_severity_decides_stream_and_exit_code(capsys):
    console = Console(quiet=True)
    console.report([Diagnostic("no_delays"), Diagnostic("traffic", "R1", "information", TRAFFIC)])
    assert (console.code, capsys.readouterr().err) == (EXIT_DONE, "")
    console.report([Diagnostic("no_ranges", severity="partial")])
    assert console.code == EXIT_PARTIAL
    assert capsys.readouterr().err.startswith("clt: warning: no range ties the team together")
    assert [one["severity"] for one in console.diagnostics] == ["warning", "information", "partial"]
    assert len(console.warnings) == 2


TRAFFIC = {"messages_sent": 1, "bytes_sent": 2, "messages_heard": 3, "bytes_heard": 4}


def test_a_log_is_named_once(capsys):
    console = Console()
    console.report([Diagnostic("several_truth_frames", values={"frames": "a, b"})], about="x.mcap")
    console.report([Diagnostic("log_failed", values={"error": "x.mcap: no"})], about="x.mcap")
    assert [line.count("x.mcap") for line in capsys.readouterr().err.splitlines()] == [1, 1]
    assert console.diagnostics[0]["text"].startswith("the truth stands")


def test_what_is_no_number_is_null_in_json():
    values = {"a": math.nan, "b": [math.inf, 1.0]}
    document = diagnostic_document(Diagnostic("misfit", values=values), "text")
    assert json.loads(json.dumps(document, allow_nan=False))["values"] == {
        "a": None,
        "b": [None, 1.0],
    }


def test_a_fault_keeps_its_kind_and_says_whether_data_is_lost():
    lost = fault_diagnostic(
        Fault("nan", 3, "x", data_lost=True, subject="R1", values={"at_s": 1.0})
    )
    assert lost == Diagnostic("nan", "R1", "partial", {"count": 3, "at_s": 1.0})
    assert fault_diagnostic(Fault("nan", 3, "x")).severity == "warning"


def test_the_mildest_comes_first_and_divergence_last():
    kinds = [
        Diagnostic(DIVERGED, "R1", "partial"), Diagnostic("no_ranges", "", "partial"),
        Diagnostic("no_delays"), Diagnostic("traffic", "", "information"),
    ]  # fmt: skip
    order = [one.kind for one in by_severity(kinds)]
    assert order == ["traffic", "no_delays", "no_ranges", DIVERGED]


def option_names(tree):
    """The strings that name an option, but for docstrings and errors that end a command."""
    skip = set()
    for node in ast.walk(tree):
        call = isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        errors = call and node.func.id.endswith("Error")
        words = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if errors or words:
            skip |= {id(one) for one in ast.walk(node)}
    return [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and id(node) not in skip
        and OPTION.search(node.value)
    ]


@pytest.mark.parametrize("room", ALGORITHMS)
def test_no_algorithm_composes_option_names(room):
    found = {path.name: option_names(tree) for path, tree in sources(room)}
    assert {name: texts for name, texts in found.items() if len(texts) > 0} == {}
