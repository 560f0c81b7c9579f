"""Clock jumps, pauses and robots whose clocks are off, by columns alone."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from clt.core.recording import Odometry, Recording
from clt.log.recording.clocks.agreement import clock_streams
from clt.log.recording.clocks.excerpt import cut_recording, extract_part
from clt.log.recording.clocks.findings import stamp_text
from clt.log.recording.clocks.parts import uninterrupted_runs
from clt.log.recording.clocks.timeline import find_timeline, first_stamp, timeline_faults
from tests.filters.teams import team_recording

SECOND = 10**9
NOW = 1_735_689_600 * SECOND


def every_table(recording, change):
    """The recording with `change(robot or None, table)` instead of each table; None: of all."""
    return replace(
        recording,
        odometry={name: change(name, one) for name, one in recording.odometry.items()},
        truth={name: change(name, one) for name, one in recording.truth.items()},
        ranges=change(None, recording.ranges),
    )


def moved(table, by, log_by=0):
    """Stamps and times of recording later by ns, one number or one per row; sorted again."""
    stamp, log_time = table.stamp + by, table.log_time + log_by
    return rows(replace(table, stamp=stamp, log_time=log_time), np.argsort(stamp, kind="stable"))


def rows(table, which):
    columns = {field.name: getattr(table, field.name) for field in fields(table)}
    return replace(
        table, **{n: one[which] for n, one in columns.items() if isinstance(one, np.ndarray)}
    )


@pytest.fixture(scope="module")
def plain() -> Recording:
    """20 s of two anchors and three robots; each pair's ranges by the first named."""
    return every_table(team_recording(), lambda _, one: moved(one, NOW, NOW))


@pytest.fixture(scope="module")
def networked(plain) -> Recording:
    """The same with delays of 0 to 150 ms."""
    rng = np.random.default_rng(1)

    def late(_, one):
        return moved(one, 0, rng.integers(0, 150_000_000, one.stamp.size))

    return every_table(plain, late)


def by_clock(recording, robot, by):
    """A recording in which the clock of one robot is `by` ns ahead, the recorder's right."""
    number = recording.team.index(robot)

    def change(name, one):
        if name == robot and isinstance(one, Odometry):
            return moved(one, by)
        return moved(one, np.where(one.source == number, by, 0)) if name is None else one

    return every_table(recording, change)


def jumped(recording, at, by, *, recorded=False):
    """All stamps before `at` s are earlier by `by` ns; with `recorded` times of recording too."""

    def change(_, one):
        early = np.where(one.stamp < NOW + at * SECOND, -by, 0)
        return moved(one, early, early if recorded else 0)

    return every_table(recording, change)


def same(a, b):
    """Whether two recordings hold the same streams."""
    pairs = [(a.ranges, b.ranges)]
    for one, other in ((a.odometry, b.odometry), (a.truth, b.truth)):
        assert set(one) == set(other)
        pairs += [(one[name], other[name]) for name in one]
    return all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for one, other in pairs
        for name in ("stamp", "log_time")
    )


def kinds(recording):
    return [(one.kind, one.subject) for one in find_timeline(recording).findings]


def test_a_sound_log_has_nothing(plain, networked):
    assert find_timeline(plain) is None
    assert find_timeline(networked) is None
    assert find_timeline(Recording(plain.team)) is None


def test_a_robot_that_joins_late_or_leaves_early_is_no_fault(plain, networked):
    for recording in (plain, networked):
        for slice_ in (slice(120, None), slice(0, 250), slice(120, 250)):
            odometry = recording.odometry | {"R2": rows(recording.odometry["R2"], slice_)}
            assert find_timeline(replace(recording, odometry=odometry)) is None


def test_a_gap_of_one_robot_is_no_fault(networked):
    stamp = networked.odometry["R2"].stamp - NOW
    there = np.flatnonzero((stamp < 3 * SECOND) | (stamp > 18 * SECOND))
    odometry = networked.odometry | {"R2": rows(networked.odometry["R2"], there)}
    assert find_timeline(replace(networked, odometry=odometry)) is None


def test_messages_that_queue_are_no_fault(networked):
    def queue(_, one):
        since = one.log_time - NOW
        held = (since > 8 * SECOND) & (since < 14 * SECOND)
        return replace(one, log_time=np.where(held, NOW + 14 * SECOND, one.log_time))

    assert find_timeline(every_table(networked, queue)) is None


def test_a_log_recorded_at_another_pace_says_nothing_of_clocks(networked):
    late = networked.odometry | {"R2": rows(networked.odometry["R2"], slice(200, None))}
    recording = replace(networked, odometry=late)
    for pace in (0, 0.2, 3):

        def change(_, one, pace=pace):
            log_time = NOW + np.rint(pace * (one.log_time - NOW)).astype(np.int64)
            return replace(one, log_time=log_time)

        assert find_timeline(every_table(recording, change)) is None


def test_the_recorder_s_own_clock_may_be_set(networked):
    for by in (NOW - SECOND, -3600 * SECOND, 3600 * SECOND):

        def change(_, one, by=by):
            return replace(
                one, log_time=one.log_time - np.where(one.log_time < NOW + 2 * SECOND, by, 0)
            )

        recording = every_table(networked, change)
        late = {"R2": rows(recording.odometry["R2"], slice(200, None))}
        assert find_timeline(replace(recording, odometry=recording.odometry | late)) is None


def test_an_old_truth_of_a_static_robot_is_no_fault(networked):
    static = replace(networked.truth["R1"], stamp=networked.truth["R1"].stamp - 7200 * SECOND)
    recording = replace(networked, truth=networked.truth | {"S1": rows(static, slice(0, 1))})
    assert find_timeline(recording) is None


def test_sparse_ranges_of_a_standing_team_are_no_pauses():
    ranges = team_recording(moving=1, range_rate=1).ranges
    slow = moved(ranges, ranges.stamp * 40, ranges.stamp * 40)
    assert np.diff(slow.stamp).max() > 40 * SECOND
    assert find_timeline(Recording(team_recording().team, ranges=slow)) is None


@pytest.mark.parametrize("by", [NOW - 10 * SECOND, 86_400 * SECOND, 5 * SECOND, -5 * SECOND])
def test_a_jump_of_all_clocks(networked, by):
    recording = jumped(networked, 6, by)
    timeline = find_timeline(recording)
    assert kinds(recording) == [("clock_jump", ())]
    assert timeline.findings[0].size == pytest.approx(by / SECOND, abs=0.3)
    assert timeline.findings[0].at == pytest.approx(NOW + 6 * SECOND - by, abs=0.2 * SECOND)
    late = cut_recording(networked, NOW + 6 * SECOND, NOW + 100 * SECOND)
    assert same(extract_part(recording, timeline, timeline.parts[0]), late)
    early = cut_recording(networked, NOW, NOW + 6 * SECOND - 1)
    assert timeline.parts[0].messages > timeline.parts[1].messages
    assert same(
        extract_part(recording, timeline, timeline.parts[1]),
        every_table(early, lambda _, one: moved(one, -by)),
    )


@pytest.mark.parametrize("by", [NOW - 10 * SECOND, 3600 * SECOND])
def test_a_pause_or_a_jump_of_the_recorder_too(plain, by):
    recording = jumped(plain, 6, by, recorded=True)
    timeline = find_timeline(recording)
    assert kinds(recording) == [("pause", ())]
    assert timeline.findings[0].size == pytest.approx(by / SECOND, abs=0.2)
    chosen = extract_part(recording, timeline, timeline.parts[0])
    assert same(chosen, cut_recording(plain, NOW + 6 * SECOND, NOW + 100 * SECOND))


@pytest.mark.parametrize("by", [-1_690_000_000 * SECOND, 5 * SECOND, -5 * SECOND])
@pytest.mark.parametrize("recorder", ["real", "delayed", "stamps"])
def test_a_robot_whose_clock_is_off(plain, networked, by, recorder):
    source = networked if recorder == "delayed" else plain
    recording = by_clock(source, "R2", by)
    if recorder == "stamps":
        recording = every_table(recording, lambda _, one: replace(one, log_time=one.stamp))
    timeline = find_timeline(recording)
    assert set(kinds(recording)) == {("clock_off", ("R2",))}
    assert timeline.findings[0].size == pytest.approx(by / SECOND, abs=0.3)
    chosen = extract_part(recording, timeline, timeline.parts[0])
    assert set(chosen.odometry) == {"R1", "R3"}
    other = source.ranges.source != source.team.index("R2")
    assert np.array_equal(chosen.ranges.stamp, source.ranges.stamp[other])


def test_one_robot_s_clock_is_set_on_the_way(networked):
    odometry = networked.odometry["R2"]
    by = np.where(odometry.stamp < NOW + 15 * SECOND, 0, 5 * SECOND)
    recording = replace(networked, odometry=networked.odometry | {"R2": moved(odometry, by)})
    timeline = find_timeline(recording)
    assert kinds(recording) == [("clock_jump", ("R2",))]
    chosen = extract_part(recording, timeline, timeline.parts[0])
    assert same(replace(chosen, odometry={}), replace(networked, odometry={}))
    assert chosen.odometry["R2"].stamp[-1] < NOW + 15 * SECOND


def test_a_reference_whose_clock_is_off_is_left_out(networked):
    truth = {name: moved(one, 8 * SECOND) for name, one in networked.truth.items()}
    recording = replace(networked, truth=truth)
    timeline = find_timeline(recording)
    assert sorted(kinds(recording)) == [("clock_off", (name,)) for name in ("R1", "R2", "R3")]
    chosen = extract_part(recording, timeline, timeline.parts[0])
    assert chosen.truth == {}
    assert same(replace(chosen, truth={}), replace(networked, truth={}))


def test_a_reference_recorded_at_its_stamps_is_believed(networked):
    """Merged later; the recorder's own clock was 100 s off."""
    odometry = {n: replace(o, log_time=o.log_time + 100 * SECOND) for n, o in
                networked.odometry.items()}  # fmt: skip
    ranges = replace(networked.ranges, log_time=networked.ranges.log_time + 100 * SECOND)
    truth = {n: replace(one, log_time=one.stamp) for n, one in networked.truth.items()}
    recording = replace(networked, odometry=odometry, ranges=ranges, truth=truth)
    assert find_timeline(recording) is None


def test_faults_say_who_where_and_how_much(networked):
    recording = by_clock(jumped(networked, 6, 3600 * SECOND), "R2", 50 * SECOND)
    faults = timeline_faults(find_timeline(recording), "x.mcap")
    assert {fault.kind for fault in faults} == {"clock_jump", "clock_off"}
    for fault in faults:
        assert fault.data_lost
        assert fault.text.startswith("x.mcap: ")
        assert set(fault.values) == {"at_s", "at_ns", "size_s"}
        assert stamp_text(int(fault.values["at_ns"])) in fault.text
    off = next(fault for fault in faults if fault.kind == "clock_off")
    assert off.subject == "R2"


def test_a_part_without_ranges_is_not_preferred(plain):
    """However much odometry it has."""
    recording = jumped(plain, 15, 3600 * SECOND, recorded=True)
    ranges = cut_recording(recording, NOW, NOW + 100 * SECOND).ranges
    timeline = find_timeline(replace(recording, ranges=ranges))
    assert timeline.parts[0].begin >= NOW + 15 * SECOND


def test_runs_are_those_of_all_data_together():
    stamp = np.arange(0, 200, 25) * SECOND
    between = np.array([10, 160, 1000, 1000]) * SECOND
    begin, end = uninterrupted_runs([stamp, between])
    assert (begin // SECOND).tolist() == [0, 1000]
    assert (end // SECOND).tolist() == [175, 1000]


def test_streams_are_by_the_robot_that_measured(plain):
    streams = clock_streams(plain)
    ranges = [stream for stream in streams if stream.role == "ranges"]
    assert sum(stream.stamp.size for stream in ranges) == plain.ranges.stamp.size
    for stream in ranges:
        assert np.all(plain.ranges.source[stream.rows] == plain.team.index(stream.robot))


def test_cut_keeps_what_lies_between(plain):
    found = cut_recording(plain, NOW + 5 * SECOND, NOW + 6 * SECOND)
    for table in (*found.odometry.values(), *found.truth.values(), found.ranges):
        assert table.stamp[0] >= NOW + 5 * SECOND
        assert table.stamp[-1] <= NOW + 6 * SECOND
    assert found.odometry["R1"].v.size == found.odometry["R1"].stamp.size == 21
    nothing = cut_recording(plain, 0, 1)
    assert nothing.odometry == {}
    assert first_stamp(nothing) is None


@pytest.mark.parametrize("seed", range(3))
def test_any_columns_make_parts_or_nothing(plain, seed):
    """Times of any size, in any order."""
    rng = np.random.default_rng(seed)
    for _ in range(10):
        largest = 10 ** rng.integers(1, 20, 2).astype(float)

        def change(_, one, largest=largest):
            n = min(int(rng.integers(1, 40)), one.stamp.size)
            times = rng.random((2, n)) * np.minimum(largest, [2e18, 9.2e18])[:, None]
            stamp, log_time = times.astype(np.int64)
            keep = rng.random(n) < rng.random()
            return rows(
                replace(
                    rows(one, slice(0, n)),
                    stamp=np.sort(np.where(keep, one.stamp[:n], stamp)),
                    log_time=np.where(keep, one.log_time[:n], log_time),
                ),
                slice(None),
            )

        recording = every_table(plain, change)
        timeline = find_timeline(recording)
        if timeline is not None:
            for part in timeline.parts[:5]:
                chosen = extract_part(recording, timeline, part)
                tables = (*chosen.odometry.values(), chosen.ranges)
                assert all(np.all(np.diff(table.stamp) >= 0) for table in tables)
                assert sum(table.stamp.size for table in tables) <= part.messages
            assert len(timeline_faults(timeline, "x")) <= 3 * 4


def in_turn(recording, until, pause):
    """R1 drives until `until` s and measures, then after a `pause` (s) R2 does."""
    first, second = (recording.team.index(name) for name in ("R1", "R2"))
    one = rows(recording.odometry["R1"], recording.odometry["R1"].stamp < NOW + until * SECOND)
    other = moved(recording.odometry["R2"], pause * SECOND, pause * SECOND)
    table = recording.ranges
    early = rows(table, (table.source == first) & (table.stamp < NOW + until * SECOND))
    late = moved(rows(table, table.source == second), pause * SECOND, pause * SECOND)
    both = {
        field.name: np.concatenate([getattr(early, field.name), getattr(late, field.name)])
        for field in fields(table)
    }
    odometry = {"R1": one, "R2": other}
    return replace(recording, odometry=odometry, ranges=replace(table, **both), truth={})


@pytest.mark.parametrize("until", [8, 19, 30])
def test_robots_that_drive_one_after_another_make_a_pause(plain, networked, until):
    """By the recorder's clock always; without it where they did not drive equally long."""
    assert kinds(in_turn(networked, until, 60)) == [("pause", ())]
    equal = until == 30
    expected = ("clock_off", ("R2",)) if equal else ("pause", ())
    assert kinds(in_turn(plain, until, 60)) == [expected]


def test_a_clock_that_was_never_set_is_off_however_long_its_robot_drove(plain):
    assert kinds(in_turn(plain, 8, -1_700_000_000)) == [("clock_off", ("R1",))]


@pytest.mark.parametrize(
    ("which", "rate"),
    [
        *((which, rate) for which in ("one", "all odometry") for rate in (0, 20, 200)),
        *(("all", rate) for rate in (0, 200)),  # at 20 a recorder's clock may have been set
    ],
)
def test_a_queue_that_comes_after_the_end_is_no_jump(networked, which, rate):
    """Some streams are held back from some time on and come at the end, at once or one by one."""
    for since in np.arange(8.0, 19.9, 1.7):

        def queue(name, one, since=since):
            held = one.stamp - NOW > since * SECOND
            if which != "all":
                held &= isinstance(one, Odometry) and (name == "R2" or which != "one")
            flush = NOW + 21 * SECOND + (np.cumsum(held) * SECOND // rate if rate > 0 else 0)
            return replace(one, log_time=np.where(held, flush, one.log_time))

        assert find_timeline(every_table(networked, queue)) is None, since
