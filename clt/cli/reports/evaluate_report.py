"""Evaluations as tables for people: what was done in the title, then the numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import degrees
from typing import TextIO

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from clt.core.printable import printable
from clt.core.printable import printable_name as shown
from clt.metrics.errors import ErrorStatistics
from clt.metrics.evaluation import Evaluation
from clt.metrics.pairs import PairNis
from clt.metrics.scores import Score

BASELINE_LABEL = "  dead reckoning"
PIPE_COLUMNS = 80
MAX_RESIDUAL_PAIRS = 10
"""Pairs in the table; the rest is in the JSON."""


def table_console(file: TextIO, columns: int = PIPE_COLUMNS) -> Console:
    """Where tables go: colours only on a terminal, so many `columns` where there is none."""
    console = Console(highlight=False, file=file)
    if not console.is_terminal:
        console.width = columns
    return console


def print_evaluation(console: Console, log: str, evaluation: Evaluation) -> None:
    """Print all tables of one log."""
    console.print(Text(evaluation_heading(log, evaluation), style="bold"), soft_wrap=True)
    console.print()
    for table in (ape_table, heading_table, motion_table, pair_table):
        made = table(evaluation)
        if made is not None:
            print_table(console, made)
    if len(evaluation.unscored) > 0:
        console.print(f"not scored, without truth: {', '.join(evaluation.unscored)}\n")
    extra = len(evaluation.pairs) - MAX_RESIDUAL_PAIRS
    if extra > 0:
        console.print(f"{extra} more pairs: clt evaluate --json\n")


def print_table(console: Console, table: Table) -> None:
    """Print a table below its title, which may be wider than the table."""
    title, table.title = str(table.title), None
    console.print(Text(title, style="bold"), soft_wrap=True)
    console.print(table)
    console.print()


def evaluation_heading(log: str, evaluation: Evaluation) -> str:
    """Which log, which filter, which frames."""
    name = f"filter {shown(evaluation.filter)}, " if evaluation.filter is not None else ""
    frames = f"frame {shown(evaluation.frame)}, truth in {shown(evaluation.truth_frame)}"
    return printable(f"{log}: {name}{frames}")


def comparison_text(evaluation: Evaluation) -> str:
    """What was compared: alignment, association, how many poses."""
    options = evaluation.options
    count = sum(score.matched for score in evaluation.estimate.scores.values())
    if options.associate == "interpolate":
        how = f"interpolated at {count} truth poses"
    else:
        how = f"{count} pairs nearest within {options.max_diff:g} s"
    return f"align {evaluation.align}, {how}"


def score_rows(evaluation: Evaluation) -> Iterator[tuple[str, str, Score | None]]:
    """(label, style, figures): each robot and the team, dead reckoning below each."""
    estimate, baseline = evaluation.estimate, evaluation.dead_reckoning
    for name, score in estimate.scores.items():
        yield evaluation.label(name), "", score
        yield BASELINE_LABEL, "dim", baseline.scores.get(name)
    if estimate.team is not None:
        yield "team", "bold", estimate.team
        yield BASELINE_LABEL, "dim", baseline.team


def ape_table(evaluation: Evaluation) -> Table:
    """Position errors in m."""
    what = "Distance error of relative poses" if evaluation.relative else "APE"
    table = new_table(f"{what} (m), {comparison_text(evaluation)}", *STATISTIC_NAMES)
    for label, style, score in score_rows(evaluation):
        if score is not None:
            table.add_row(label, *map(metres_text, statistic_values(score.ape)), style=style)
    return table


def heading_table(evaluation: Evaluation) -> Table | None:
    """Heading errors, rmse in rad, everything in degrees."""
    head = ["rmse rad", *(f"{name}\N{DEGREE SIGN}" for name in STATISTIC_NAMES)]
    table = new_table("Heading error (rad, degrees)", *head)
    for label, style, score in score_rows(evaluation):
        if score is not None and score.heading is not None:
            numbers = [f"{degrees(value):.2f}" for value in statistic_values(score.heading)]
            table.add_row(label, metres_text(score.heading.rmse), *numbers, style=style)
    return table if table.row_count > 0 else None


def motion_table(evaluation: Evaluation) -> Table:
    """RPE, consistency, matches."""
    delta = evaluation.options.delta
    table = new_table(
        f"RPE over {delta} (rmse); ANEES (3 expected); least share of x, y, heading in 3 sigma",
        "RPE m",
        "RPE\N{DEGREE SIGN}",
        "ANEES",
        "95 %",
        "3 sigma",
        "matched",
        "share",
    )
    for label, style, score in score_rows(evaluation):
        if score is not None:
            table.add_row(label, *motion_cells(score), style=style)
    return table


def motion_cells(score: Score) -> list[str]:
    """The cells of one row of `motion_table`."""
    rpe, anees, inside = score.rpe, score.anees, score.inside
    return [
        "-" if rpe is None else metres_text(rpe.translation.rmse),
        "-" if rpe is None else f"{degrees(rpe.heading.rmse):.2f}",
        "-" if anees is None else number_text(anees.value),
        "-" if anees is None else "-".join(map(number_text, anees.interval)),
        "-" if inside is None else f"{percent_text(min(inside.values()))} %",
        str(score.matched),
        f"{percent_text(score.share)} %",
    ]


def pair_table(evaluation: Evaluation) -> Table | None:
    """Ranges by pair, those that fit worst first; a star where a figure is not chance."""
    if evaluation.all_pairs is None:
        return None
    table = new_table(
        "Ranges by pair, residuals in m (mean NIS: 1 expected; *: not chance)",
        "ranges",
        "rejected",
        "mean NIS",
        "mean",
        "std",
        "corr.",
    )
    worst = sorted(evaluation.pairs.items(), key=lambda item: pair_sort_key(item[1]), reverse=True)
    for name, pair in [*worst[:MAX_RESIDUAL_PAIRS], ("all", evaluation.all_pairs)]:
        cells = (
            with_star(f"{100 * pair.rejected:.2f} %", "rejected", pair),
            with_star(None if pair.nis is None else f"{pair.nis:.3g}", "nis", pair),
            with_star(None if pair.mean is None else f"{pair.mean:+.3g}", "mean", pair),
            "-" if pair.std is None else f"{pair.std:.3g}",
            with_star(
                None if pair.autocorrelation is None else f"{pair.autocorrelation:+.2f}",
                "autocorrelation",
                pair,
            ),
        )
        table.add_row(name, str(pair.count), *cells, style="bold" if name == "all" else "")
    return table


def pair_sort_key(pair: PairNis) -> tuple[int, float]:
    """To sort pairs by: how many figures are not chance, then the mean NIS."""
    return len(pair.significant), pair.nis or 0.0


def with_star(text: str | None, figure: str, pair: PairNis) -> str:
    """A figure of a pair, with a star where it is not chance."""
    return "-" if text is None else f"{text}{'*' if figure in pair.significant else ''}"


def print_team_table(console: Console, evaluations: Mapping[str, Evaluation]) -> None:
    """One row per log: the team's figures."""
    head = ("align", "APE m", "head\N{DEGREE SIGN}", "ANEES", "dead reckoning m", "share")
    table = new_table("Team of each log (rmse)", *head)
    for log, evaluation in evaluations.items():
        team, baseline = evaluation.estimate.team, evaluation.dead_reckoning.team
        if team is None:
            table.add_row(Text(printable(log)), evaluation.align, *["-"] * 5)
        else:
            table.add_row(
                log,
                evaluation.align,
                metres_text(team.ape.rmse),
                "-" if team.heading is None else f"{degrees(team.heading.rmse):.2f}",
                "-" if team.anees is None else number_text(team.anees.value),
                "-" if baseline is None else metres_text(baseline.ape.rmse),
                f"{percent_text(team.share)} %",
            )
    print_table(console, table)


STATISTIC_NAMES = ("rmse", "mean", "median", "std", "min", "max", "p95")


def statistic_values(statistics: ErrorStatistics) -> list[float]:
    """The values in the order of `STATISTIC_NAMES`."""
    return [getattr(statistics, name) for name in STATISTIC_NAMES]


def metres_text(value: float) -> str:
    """Three decimals, fewer for what is far off."""
    return f"{value:.3f}" if value < 1000.0 else f"{value:.3g}"


def number_text(value: float) -> str:
    """Two decimals, fewer for what is far off."""
    return f"{value:.2f}" if value < 100.0 else f"{value:.3g}"


def percent_text(share: float) -> str:
    """A share in percent that says 100 only when it is all."""
    text = f"{100 * share:.1f}"
    return "100" if share == 1.0 else "99.9" if text == "100.0" else text


def new_table(title: str, *columns: str) -> Table:
    """A table whose first column names the row; numbers stand right."""
    table = Table(title=title, box=SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
    table.add_column("", overflow="fold")
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table
