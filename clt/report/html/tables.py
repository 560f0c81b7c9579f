"""Tables of the page: scores, pairs, messages, and how the log came to be."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from math import degrees

from clt.core.recording import Recording
from clt.metrics.evaluation import Evaluation
from clt.metrics.scores import Score

SCORE_HEADINGS = (
    "", "APE rmse, m", "median, m", "p95, m", "max, m", "heading rmse, rad",
    "heading rmse, \N{DEGREE SIGN}", "ANEES (3 expected)", "matched",
)  # fmt: skip
PAIR_HEADINGS = (
    "pair", "ranges", "rejected", "mean, m", "std, m", "autocorrelation", "NIS (1 expected)",
)  # fmt: skip
TRAFFIC_HEADINGS = ("robot", "messages sent", "bytes sent", "messages heard", "bytes heard")
SHOWN_RUN_KEYS = (
    "command", "version", "filter", "frame", "engine", "init", "order", "seed", "scenario",
)  # fmt: skip
"""Of the run record, in one line each; the rest is shown folded."""


def table(headings: Sequence[str], rows: Iterator[tuple[str, Sequence[str]]], caption: str) -> str:
    """A table of texts; a row is its class and its cells, the first of which names the row."""
    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in headings)
    body = ""
    for look, (name, *cells) in rows:
        rest = "".join(f"<td>{escape(cell)}</td>" for cell in cells)
        body += f'<tr class="{look}"><th scope="row">{escape(name)}</th>{rest}</tr>\n'
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}"><table>'
        f"<caption>{escape(caption)}</caption>\n<thead><tr>{head}</tr></thead>\n"
        f"<tbody>\n{body}</tbody></table></div>\n"
    )


def score_table(evaluation: Evaluation) -> str:
    """Errors by robot, dead reckoning beside them."""
    return table(SCORE_HEADINGS, _score_rows(evaluation), "Errors by robot")


def _score_rows(evaluation: Evaluation) -> Iterator[tuple[str, Sequence[str]]]:
    estimate, baseline = evaluation.estimate, evaluation.dead_reckoning
    for name, score in estimate.scores.items():
        yield "", score_cells(evaluation.label(name), score)
        if name in baseline.scores:
            yield "baseline", score_cells(f"{name}: dead reckoning", baseline.scores[name])
    if estimate.team is not None:
        yield "", score_cells("team", estimate.team)
    if baseline.team is not None:
        yield "baseline", score_cells("team: dead reckoning", baseline.team)


def score_cells(label: str, score: Score) -> list[str]:
    """One row of scores."""
    ape, heading, anees = score.ape, score.heading, score.anees
    interval = "" if anees is None else f" ({anees.interval[0]:.2f} to {anees.interval[1]:.2f})"
    return [
        label,
        *(f"{value:.3f}" for value in (ape.rmse, ape.median, ape.p95, ape.max)),
        "-" if heading is None else f"{heading.rmse:.4f}",
        "-" if heading is None else f"{degrees(heading.rmse):.2f}",
        "-" if anees is None else f"{anees.value:.2f}{interval}",
        f"{score.matched} ({100 * score.share:.4g} %)",
    ]


def pair_table(evaluation: Evaluation) -> str:
    """Ranges by pair; what is hardly chance has a star. Empty without innovations."""
    if evaluation.all_pairs is None:
        return ""
    caption = "Residuals of the ranges by pair; * is hardly chance"
    return table(PAIR_HEADINGS, _pair_rows(evaluation), caption)


def _pair_rows(evaluation: Evaluation) -> Iterator[tuple[str, Sequence[str]]]:
    everyone = evaluation.all_pairs
    pairs = evaluation.pairs if everyone is None else {"all pairs": everyone, **evaluation.pairs}
    for name, pair in pairs.items():
        star = {one: "*" if one in pair.significant else "" for one in pair.significant}
        values = (
            (pair.mean, "mean"), (pair.std, ""), (pair.autocorrelation, "autocorrelation"),
            (pair.nis, "nis"),
        )  # fmt: skip
        yield (
            "",
            [
                name,
                str(pair.count),
                f"{100 * pair.rejected:.2f} %{star.get('rejected', '')}",
                *(
                    "-" if value is None else f"{value:.3f}{star.get(one, '')}"
                    for value, one in values
                ),
            ],
        )


def traffic_of(recording: Recording) -> Mapping[str, Mapping[str, int]]:
    """Messages and bytes of each robot of a distributed filter; empty for other filters."""
    found = _parsed(recording.run.get("traffic", "{}"))
    return found if isinstance(found, dict) else {}


def traffic_table(traffic: Mapping[str, Mapping[str, int]], seconds: float) -> str:
    """What the robots of a distributed filter said, with the mean rate in the caption."""
    total = sum(one["bytes_sent"] for one in traffic.values())
    rate = total / max(seconds, 1e-9) / max(len(traffic), 1)
    keys = ("messages_sent", "bytes_sent", "messages_heard", "bytes_heard")
    rows = (("", [name, *(f"{one[key]}" for key in keys)]) for name, one in traffic.items())
    caption = f"Messages of the distributed filter; {rate:.0f} bytes/s sent by a robot on average"
    return table(TRAFFIC_HEADINGS, rows, caption)


def run_section(recording: Recording) -> str:
    """How the log came to be: command, version, inputs, and folded the whole configuration."""
    run = recording.run
    lines = [(key, run[key]) for key in SHOWN_RUN_KEYS if key in run]
    inputs = _parsed(run.get("inputs", "{}"))
    if isinstance(inputs, dict):
        lines += [(f"input {name}", f"SHA-256 {digest}") for name, digest in inputs.items()]
    if len(lines) == 0:
        return "<p>The log holds no record of how it came to be.</p>\n"
    shown = "".join(
        f"<dt>{escape(key)}</dt><dd><code>{escape(text)}</code></dd>\n" for key, text in lines
    )
    rest = {key: _parsed(text) for key, text in run.items() if key not in {*SHOWN_RUN_KEYS}}
    for name, document in rest.items():
        if name != "inputs" and document not in ([], {}, ""):
            text = document if isinstance(document, str) else json.dumps(document, indent=1)
            shown += (
                f"<dt>{escape(name)}</dt><dd><details><summary>show {escape(name)}</summary>"
                f'<pre tabindex="0">{escape(text)}</pre></details></dd>\n'
            )
    return f"<dl>\n{shown}</dl>\n"


def _parsed(text: str) -> object:
    """The document of a record; the text itself where it is none."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text
