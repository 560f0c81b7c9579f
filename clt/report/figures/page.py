"""One self-contained HTML page: the figure as inline SVG and the figures as a table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from math import degrees

from clt.core.recording import Recording
from clt.metrics.evaluation import Evaluation
from clt.metrics.scores import Score
from clt.report.figures import plain
from clt.report.figures.figure import evaluation_subtitle, evaluation_title, log_figure_svg

PAGE_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; margin: 2rem auto; max-width: 1240px;
       padding: 0 1rem; }
svg { width: 100%; height: auto; }
table { border-collapse: collapse; margin: 1.5rem 0; }
th, td { text-align: right; padding: .25rem .9rem; border-bottom: 1px solid #e4e4e4; }
th:first-child, td:first-child { text-align: left; }
.baseline { color: #777; } .warning { color: #b00020; }
"""
SCORE_HEADINGS = (
    "", "APE rmse, m", "median", "p95", "max", "heading rmse, rad", "\N{DEGREE SIGN}", "ANEES",
    "matched",
)  # fmt: skip


def html_page(
    log: str, recording: Recording, evaluation: Evaluation | None, warnings: Sequence[str] = ()
) -> str:
    """The whole page, with lines of `warnings`; it loads nothing from elsewhere.

    Raises CltError as `draw` does.
    """
    figure = log_figure_svg(recording, evaluation)
    if evaluation is None:
        return _html_document(
            log, plain.unscored_title(recording), plain.unscored_subtitle(recording), figure
        )
    said = "\n".join(f'<p class="warning">{escape(text)}</p>' for text in warnings)
    head = "".join(f"<th>{escape(name)}</th>" for name in SCORE_HEADINGS)
    rest = f"""{said}
<table>
<thead><tr>{head}</tr></thead>
<tbody>
{"".join(_rows(evaluation))}</tbody>
</table>
"""
    return _html_document(
        log,
        evaluation_title(evaluation),
        evaluation_subtitle(recording, evaluation),
        figure + "\n" + rest,
    )


def _html_document(log: str, headline: str, about: str, body: str) -> str:
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(log)}: {escape(headline)}</title>
<style>{PAGE_STYLE}</style>
</head>
<body>
<h1>{escape(log)}</h1>
<p>{escape(about)}</p>
{body}</body>
</html>
"""


def _rows(evaluation: Evaluation) -> Iterator[str]:
    estimate, baseline = evaluation.estimate, evaluation.dead_reckoning
    for name, score in estimate.scores.items():
        yield _row(name, score, "")
        yield _row("dead reckoning", baseline.scores.get(name), "baseline")
    yield _row("team", estimate.team, "")
    yield _row("dead reckoning", baseline.team, "baseline")


def _row(label: str, score: Score | None, look: str) -> str:
    if score is None:
        return ""
    ape, heading, anees = score.ape, score.heading, score.anees
    cells = [
        escape(label),
        *(f"{value:.3f}" for value in (ape.rmse, ape.median, ape.p95, ape.max)),
        "-" if heading is None else f"{heading.rmse:.4f}",
        "-" if heading is None else f"{degrees(heading.rmse):.2f}",
        "-" if anees is None else f"{anees.value:.2f}",
        f"{score.matched} ({100 * score.share:.4g} %)",
    ]
    return f'<tr class="{look}">' + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>\n"
