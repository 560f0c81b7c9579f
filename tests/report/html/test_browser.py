"""The page in a real browser: it draws, the slider moves the robots, nothing leaves it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from clt.metrics.evaluate import evaluate
from clt.report.html.page import html_report
from clt.report.html.run import ReportRun
from tests.report.html.browser import MISSING, PROGRAM, Browser
from tests.report.html.test_page import TRAFFIC

pytestmark = pytest.mark.skipif(PROGRAM is None, reason=MISSING)

ROBOTS = "document.getElementById('map-0').data.find((one) => one.name === 'robots')"
PLACES = f"[...{ROBOTS}.x].concat([...{ROBOTS}.y])"
DRAWN = """document.querySelectorAll(
  '#map-0 .points text, #map-0 .textpoint').length"""
ARROW_LEFT = ("ArrowLeft", 37)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    found = Browser(tmp_path_factory.mktemp("profile"))
    yield found
    found.close()


@pytest.fixture
def page(browser, tmp_path):
    """Open the page of some runs; at the end nothing may have been asked for or complained of."""
    browser.requests.clear()
    browser.complaints.clear()
    browser.resize(1280, 900)

    def open_page(*runs) -> Path:
        path = tmp_path / "page.html"
        path.write_text(html_report(runs), encoding="utf-8")
        browser.open(path)
        return path

    yield open_page
    browser.run("new Promise((done) => setTimeout(done, 50))")  # what was begun may yet complain
    assert browser.complaints == []
    assert browser.outside() == []
    assert len(browser.requests) >= 1  # the page itself: what is asked for is seen


def choose(browser, select, value):
    """What a reader does with a list."""
    browser.run(f"document.getElementById('{select}').value = '{value}'")
    browser.run(f"document.getElementById('{select}').dispatchEvent(new Event('change'))")


def scored(recording, name="run.mcap"):
    return ReportRun(name, recording, evaluate(recording))


def test_everything_is_drawn(browser, page, synthetic):
    recording = replace(synthetic(n=120), run={"traffic": json.dumps(TRAFFIC)})
    page(scored(recording))
    for plot, traces in (("map-0", 18), ("time-0", 15), ("pairs-0", 5), ("traffic-0", 2)):
        assert browser.run(f"document.getElementById('{plot}').data.length") >= traces, plot
        assert browser.run(f"document.querySelectorAll('#{plot} path').length") > 5
    names = browser.run(
        "[...document.querySelectorAll('#map-0 text')].map((one) => one.textContent)"
    )
    assert {"R1", "R2", "R3", "A1", "A2"} <= set(names)
    assert {"R1 (estimate)", "truth", "range used", "true position now"} <= set(names)


def test_nothing_can_be_uploaded(browser, page, synthetic):
    page(scored(synthetic(n=30)))
    buttons = browser.run(
        "[...document.querySelectorAll('.modebar-btn')].map((b) => b.dataset.title)"
    )
    assert "Pan" in buttons
    assert [one for one in buttons if "hare" in one or "loud" in one] == []
    blocked = browser.run("fetch('https://example.org/').then(() => 'sent', () => 'blocked')")
    assert blocked == "blocked"
    # The policy of the page refused it, and says so: the only complaint there may be.
    assert all("Content Security Policy" in str(one) for one in browser.complaints)
    assert len(browser.complaints) > 0
    browser.complaints.clear()
    assert browser.outside() == []


def test_the_slider_moves_the_robots(browser, page, synthetic):
    recording = synthetic(n=120)
    page(scored(recording))
    track = recording.estimate["R1"]
    browser.until(f"Math.abs({ROBOTS}.x[0] - {track.x[-1]}) < 1e-4")
    end = browser.run(PLACES)
    browser.run("document.getElementById('slider-0').focus()")
    for _ in range(19):
        browser.press(*ARROW_LEFT)
    browser.until("document.getElementById('slider-0').value === '100'")
    browser.until(f"Math.abs({ROBOTS}.x[0] - {track.x[100]}) < 1e-4")
    before = browser.run(PLACES)
    assert max(abs(a - b) for a, b in zip(end, before, strict=True)) > 0.1
    assert browser.run("document.getElementById('now-0').textContent") == "5.0 s"
    assert (
        browser.run("document.getElementById('slider-0').getAttribute('aria-valuetext')") == "5.0 s"
    )


def test_playing_goes_on_and_stops(browser, page, synthetic):
    page(scored(synthetic(n=60)))
    browser.run("document.getElementById('play-0').click()")
    browser.until("Number(document.getElementById('slider-0').value) > 5")
    assert browser.run("document.getElementById('play-0').textContent") == "Pause"
    browser.run("document.getElementById('play-0').click()")
    assert browser.run("document.getElementById('play-0').getAttribute('aria-pressed')") == "false"


def test_one_robot_and_one_pair_can_be_chosen(browser, page, synthetic):
    page(scored(synthetic(n=60)))
    choose(browser, "robot-0", "R2")
    shown = browser.run(
        "document.getElementById('time-0').data"
        ".filter((one) => one.visible === true).map((one) => one.name)"
    )
    assert set(shown) == {"R2"}
    choose(browser, "pair-0", "A2-R1")
    browser.until("document.getElementById('pair-note-0').textContent.startsWith('60 ranges')")
    assert browser.run("document.getElementById('pairs-0').data[0].x.length") <= 60


def test_a_click_on_a_time_moves_the_slider(browser, page, synthetic):
    page(scored(synthetic(n=60)))
    browser.run(
        "document.getElementById('time-0').emit('plotly_click', "
        "{points: [{x: 1.02, xaxis: {_name: 'xaxis'}}]})"
    )
    assert browser.run("document.getElementById('now-0').textContent") == "1.0 s"


@pytest.mark.parametrize("width", [1280, 390])
def test_it_fits_the_window_and_can_be_read_without_a_mouse(browser, page, synthetic, width):
    browser.resize(width, 800)
    page(scored(synthetic(n=60)))
    assert browser.run("document.documentElement.scrollWidth") <= width
    browser.press("Tab", 9)
    assert browser.run("document.activeElement.className") == "skip"
    missing = browser.run(
        "[...document.querySelectorAll('button, input, select')].filter((one) => "
        "one.offsetParent && !one.labels?.length && !one.textContent && !one.ariaLabel).length"
    )
    assert missing == 0
    assert browser.run("[...document.querySelectorAll('[role=img]')].every((one) => one.ariaLabel)")


def test_without_truth_and_without_estimates(browser, page, synthetic, measured_log):
    bare = replace(synthetic(n=40), truth={}, innovations=None)
    page(ReportRun("bare.mcap", bare, None), ReportRun("log.mcap", measured_log, None))
    assert browser.run("document.getElementById('pair-0')") is None
    assert browser.run("document.getElementById('time-1').data.length") == 2
    assert "2 ranges" in browser.run("document.getElementById('pair-note-1').textContent")
    titles = browser.run("[...document.querySelectorAll('h3')].map((one) => one.textContent)")
    assert "Odometry over time (not localized yet)" in titles


def test_runs_stand_side_by_side(browser, page, synthetic):
    page(scored(synthetic(n=60), "a"), scored(synthetic(n=60, seed=5), "b"))
    assert browser.run("document.getElementById('comparison').data.map((one) => one.name)") == [
        "a",
        "b",
    ]
    assert browser.run("document.getElementById('slider-1').max") == "59"
