"""The page: everything in one file; it forbids the browser to load anything from elsewhere."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from importlib.resources import files

from clt.core.errors import CltError
from clt.metrics.evaluation import Evaluation
from clt.report.figures.single import team_error
from clt.report.figures.style import ALARM_COLOUR, GREY_COLOUR, INK_COLOUR, ROBOT_COLOURS
from clt.report.html import tables
from clt.report.html.encode import Document, encode_floats, script_json
from clt.report.html.map_data import map_document
from clt.report.html.pair_data import pair_document
from clt.report.html.run import ReportRun
from clt.report.html.scene import build_scene
from clt.report.html.time_series import time_panels
from clt.report.html.window_data import window_document

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; form-action 'none'; base-uri 'none'"
)
"""What the browser lets the page do: run and show what is in it, fetch nothing."""
SCRIPTS = ("data.js", "map.js", "panels.js", "page.js")
COMPARISON_HEADINGS = ("run", *tables.SCORE_HEADINGS[1:])


def html_report(runs: Sequence[ReportRun]) -> str:
    """The whole page of one or several logs.

    Raises CltError where plotly is not installed, or a log holds nothing to draw.
    """
    bundle = plotly_bundle()
    documents = [_run_document(run) for run in runs]
    data = {
        "colours": ROBOT_COLOURS,
        "ink": INK_COLOUR,
        "grey": GREY_COLOUR,
        "alarm": ALARM_COLOUR,
        "runs": documents,
    }
    title = runs[0].name if len(runs) == 1 else f"{len(runs)} runs"
    asset = files(__package__)
    style = (asset / "report.css").read_text(encoding="utf-8")
    scripts = "\n".join((asset / name).read_text(encoding="utf-8") for name in SCRIPTS)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{escape(POLICY)}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}: {escape(runs[0].title)}</title>
<link rel="icon" href="data:,">
<style>{style}</style>
</head>
<body>
<a class="skip" href="#content">Skip to the content</a>
<main id="content">
{_comparison(runs)}{"".join(_run_section(run, k, len(runs)) for k, run in enumerate(runs))}</main>
<footer><p>Made by clt. Lines are drawn with fewer points than there are data: of a path every
k-th, of values over time the least and the largest of each interval, so that peaks stay; of dots
every k-th. Figures in tables and histograms are from all data.</p></footer>
<noscript><p>The drawings need JavaScript; the tables do not.</p></noscript>
<script type="application/json" id="data">{script_json(data)}</script>
<script>{bundle}</script>
<script>
{scripts}
</script>
</body>
</html>
"""


def plotly_bundle() -> str:
    """The code of plotly.js that the installed plotly carries."""
    try:
        from plotly.offline import get_plotlyjs  # noqa: PLC0415 - an extra
    except ImportError:
        raise CltError("pages (.html) need plotly: pip install 'clt[report]'") from None
    return str(get_plotlyjs())


def _run_document(run: ReportRun) -> Document:
    begin, end = run.span
    scene = build_scene(run.recording, run.evaluation)
    _, panels = time_panels(run.recording, run.evaluation, begin)
    windows, evaluation = run.windows, run.evaluation
    traffic = tables.traffic_of(run.recording)
    moving = [robot.name for robot in run.recording.team.moving]
    drawn = dict.fromkeys(
        [*moving, *scene.tracks, *(evaluation.estimate.tracks if evaluation else ())]
    )
    return {
        "name": run.name,
        "robots": list(drawn),
        "seconds": (end - begin) * 1e-9,
        "map": map_document(run.recording, scene, begin, end),
        "panels": panels,
        "pairs": pair_document(run.recording, begin),
        "windows": None if windows is None else window_document(windows, begin),
        "traffic": {name: dict(one) for name, one in traffic.items()},
        "team_error": None if evaluation is None else _team_error(evaluation),
    }


def _team_error(evaluation: Evaluation) -> Document:
    time, value = team_error(evaluation)
    return {"time": encode_floats(time), "value": encode_floats(value)}


def _comparison(runs: Sequence[ReportRun]) -> str:
    """A table with a row per run and the error of the team over time; empty for one run."""
    if len(runs) == 1:
        return ""

    def rows() -> Iterator[tuple[str, Sequence[str]]]:
        for run in runs:
            team = None if run.evaluation is None else run.evaluation.estimate.team
            if team is None:
                yield "", [run.name, *["-"] * (len(COMPARISON_HEADINGS) - 1)]
            else:
                yield "", tables.score_cells(run.name, team)

    links = "".join(
        f'<li><a href="#run-{k}">{escape(run.name)}</a></li>' for k, run in enumerate(runs)
    )
    return f"""<h1>{len(runs)} runs compared</h1>
<nav aria-label="Runs"><ul>{links}</ul></nav>
{tables.table(COMPARISON_HEADINGS, rows(), "Errors of the team by run")}
{_figure("comparison", "Error of the team over time, by run")}
"""


def _run_section(run: ReportRun, number: int, count: int) -> str:
    """All of one run: its ids end in its number."""
    k = number
    level = 1 if count == 1 else 2
    inner = level + 1
    heading, panels = time_panels(run.recording, run.evaluation, run.span[0])
    said = "\n".join(f'<p class="warning">{escape(text)}</p>' for text in run.warnings)
    kind = pair_document(run.recording, run.span[0])["kind"]
    pair_title = {
        "residuals": "Residuals of the ranges, in units of their predicted sigma",
        "ranges": "Ranges by pair",
    }[kind]
    evaluation = run.evaluation
    scores = "" if evaluation is None else tables.score_table(evaluation)
    pairs = "" if evaluation is None else tables.pair_table(evaluation)
    parts = [
        f'<section class="run" id="run-{k}" aria-labelledby="title-{k}">\n',
        f'<h{level} id="title-{k}">{escape(run.name)}</h{level}>\n',
        f"<p><strong>{escape(run.title)}</strong><br>{escape(run.subtitle)}</p>\n{said}\n{scores}",
        _section(inner, k, "map", "Map", _controls(k) + _figure(f"map-{k}", _map_label(run))),
    ]
    if len(panels) > 0:
        parts.append(_section(inner, k, "time", heading, _figure(f"time-{k}", heading)))
    parts.append(
        _section(
            inner, k, "pairs", pair_title,
            f'<p><label for="pair-{k}">Pair</label> <select id="pair-{k}"></select> '
            f'<span id="pair-note-{k}" role="status"></span></p>\n'
            + _figure(f"pairs-{k}", pair_title) + pairs,
        )
    )  # fmt: skip
    if run.windows is not None:
        title = "Observability along the log"
        parts.append(_section(inner, k, "windows", title, _figure(f"windows-{k}", title)))
    elif run.windows_note != "":
        note = f"<p>{escape(run.windows_note)}</p>\n"
        parts.append(_section(inner, k, "windows", "Observability along the log", note))
    traffic = tables.traffic_of(run.recording)
    if len(traffic) > 0:
        begin, end = run.span
        body = _figure(f"traffic-{k}", "Bytes sent and heard by robot")
        body += tables.traffic_table(traffic, (end - begin) * 1e-9)
        parts.append(_section(inner, k, "traffic", "Communication", body))
    parts.append(
        _section(inner, k, "origin", "Configuration and origin", tables.run_section(run.recording))
    )
    return "".join(parts) + "</section>\n"


def _section(level: int, number: int, name: str, title: str, body: str) -> str:
    ident = f"{name}-title-{number}"
    return (
        f'<section aria-labelledby="{ident}">\n<h{level} id="{ident}">{escape(title)}</h{level}>\n'
        f"{body}</section>\n"
    )


def _figure(ident: str, label: str) -> str:
    return f'<div class="plot" id="{ident}" role="img" aria-label="{escape(label)}"></div>\n'


def _map_label(run: ReportRun) -> str:
    names = ", ".join(robot.name for robot in run.recording.team.moving)
    return f"Map of the trajectories of {names}; the time slider above moves the robots"


def _controls(k: int) -> str:
    """Time slider, playing, and which robot is shown."""
    return f"""<div class="controls">
<button type="button" id="play-{k}" aria-pressed="false">Play</button>
<label for="slider-{k}">Time</label>
<input type="range" id="slider-{k}" min="0" value="0" step="1">
<output id="now-{k}" for="slider-{k}"></output>
<label for="robot-{k}">Robot</label>
<select id="robot-{k}"><option value="">all</option></select>
<label><input type="checkbox" id="whole-{k}"> whole paths</label>
</div>
"""
