from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from clt.metrics.evaluate import evaluate
from clt.report.html.page import html_report
from clt.report.html.run import ReportRun
from clt.report.html.tables import run_section, traffic_table

VOID = {"meta", "link", "input", "br"}
TRAFFIC = {
    "R1": {"messages_sent": 10, "bytes_sent": 600, "messages_heard": 9, "bytes_heard": 540},
    "R2": {"messages_sent": 20, "bytes_sent": 1400, "messages_heard": 8, "bytes_heard": 480},
}


class Outline(HTMLParser):
    """Elements, ids and headings of a page; every element must be closed."""

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.headings, self.sources, self.labels = [], [], [], [], []

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.ids += [found["id"]] if "id" in found else []
        self.labels += [found["for"]] if tag in {"label", "output"} and "for" in found else []
        self.headings += [int(tag[1])] if re.fullmatch("h[1-6]", tag) else []
        self.sources += [text for name, text in attrs if name in {"src", "href", "action"}]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture
def run(synthetic):
    recording = synthetic(n=60)
    return ReportRun("a <b>.mcap", recording, evaluate(recording), warnings=["much & more"])


def outline(page):
    found = Outline()
    found.feed(page)
    assert found.open == []
    return found


def test_the_page_is_whole_and_names_nothing_outside(run):
    page = html_report([run])
    found = outline(page)
    assert len(found.ids) == len(set(found.ids))
    assert found.headings == [1, 2, 2, 2, 2]
    assert set(found.labels) <= set(found.ids)
    assert all(one.startswith(("#", "data:")) for one in found.sources)
    assert "default-src &#x27;none&#x27;" in page
    assert "a &lt;b&gt;.mcap" in page
    assert "much &amp; more" in page
    assert "<b>.mcap" not in page


def test_its_numbers_are_readable(run):
    page = html_report([run])
    data = json.loads(
        re.search(r'<script type="application/json" id="data">(.*?)</script>', page)[1]
    )
    (one,) = data["runs"]
    assert one["robots"] == ["R1", "R2", "R3"]
    assert one["seconds"] == pytest.approx(59 * 0.05)
    assert one["windows"] is None


def test_several_runs_are_compared(run, synthetic):
    bare = replace(synthetic(n=30), truth={})
    page = html_report([run, ReportRun("bare.mcap", bare, None)])
    found = outline(page)
    assert "2 runs compared" in page
    assert {"run-0", "run-1", "comparison", "slider-1"} <= set(found.ids)
    assert len(found.ids) == len(set(found.ids))
    row = re.search(r'<th scope="row">bare.mcap</th>(.*?)</tr>', page)[1]
    assert set(re.findall("<td>(.*?)</td>", row)) == {"-"}


def test_the_table_holds_the_figures_of_the_evaluation(run):
    page = html_report([run])
    team = run.evaluation.estimate.team
    row = re.search(r'<th scope="row">team</th>(.*?)</tr>', page)[1]
    assert f"<td>{team.ape.rmse:.3f}</td>" in row
    assert f"<td>{team.heading.rmse:.4f}</td>" in row
    assert "R1: dead reckoning" in page


def test_a_distributed_filter_shows_its_messages(run):
    recording = replace(run.recording, run={"traffic": json.dumps(TRAFFIC)})
    page = html_report([replace(run, recording=recording)])
    assert "traffic-0" in outline(page).ids
    text = traffic_table(TRAFFIC, 10.0)
    assert "100 bytes/s" in text  # 2000 bytes of two robots in 10 s
    assert "<td>1400</td>" in text
    assert "traffic-0" not in outline(html_report([run])).ids


def test_the_record_of_a_run_is_shown(run):
    record = {
        "command": "clt localize <log>", "inputs": json.dumps({"log.mcap": "ab12"}),
        "config": json.dumps({"noise": {"sigma_v": 0.1}}), "warnings": "[]", "input_run": "no json",
    }  # fmt: skip
    text = run_section(replace(run.recording, run=record))
    assert "<code>clt localize &lt;log&gt;</code>" in text
    assert "SHA-256 ab12" in text
    assert "show config" in text
    assert "show warnings" not in text
    assert "no record" in run_section(replace(run.recording, run={}))


def test_why_there_are_no_windows_is_said(run):
    page = html_report([replace(run, windows_note="It cannot be analysed: too short.")])
    assert "It cannot be analysed: too short." in page
    assert "windows-0" not in outline(page).ids


def test_the_same_log_gives_the_same_page(run):
    assert html_report([run]) == html_report([run])
