import pytest

from clt.core.errors import UsageError
from clt.core.settings import known_keys, parse_literal
from clt.sim.scenario import Scenario, built_in_names, effective_toml, load_scenario


def refused(overrides):
    with pytest.raises(UsageError) as caught:
        load_scenario("shi-sim", overrides)
    return str(caught.value)


def test_built_ins_load_and_describe_themselves():
    assert "shi-sim" in built_in_names()
    for name in built_in_names():
        scenario = load_scenario(name)
        assert scenario.name == name
        assert len(scenario.description) > 10


@pytest.mark.parametrize("key", known_keys(Scenario))
def test_a_misspelt_key_is_refused_wherever_it_stands(key):
    kind = {"segments": "segments", "ramp": "segments", "repeat": "segments", "radius": "circle",
            "turn": "circle", "phases": "sequence", "turn_radius": "segments",
            }.get(key.removeprefix("trajectory."), "wander")  # fmt: skip
    needed = {
        "segments": {"segments": [SEGMENT]},
        "sequence": {"phases": [{"duration": 1.0, "drive": {"kind": "stand"}}]},
    }
    table = {"kind": kind} | needed.get(kind, {})
    leaf = key.rsplit(".", maxsplit=1)[-1]
    text = refused({"trajectory": table, f"{key}x": 1})
    assert text == f"options: unknown key `{key}x`, did you mean `{leaf}`?"


SEGMENT = {"duration": 1.0, "v": 0.5, "omega": 0.0}


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        ({"robots": [{"name": "A", "statc": True}]}, "unknown key `robots.0.statc`"),
        ({"robots": [{"name": "A"}, {"name": "A"}]}, "two robots share a name"),
        ({"robots": [{"name": "1A"}]}, "`robots.0.name`: must be a name"),
        ({"robots": [{"name": "A", "position": [0, 0]}]}, "A moves: it has a start"),
        ({"robots": [{"name": "A", "static": True, "start": [0, 0, 0]}]}, "A is static"),
        ({"team.area": [3, 0, 1, 1]}, "area is [xmin, ymin, xmax, ymax]"),
        ({"team.moving": 0}, "`team.moving`: must be at least 1"),
        ({"duration": 0}, "`duration`: must be above 0"),
        ({"duration": float("nan")}, "`duration`: must be a finite number"),
        ({"seed": -1}, "`seed`"),
        ({"outliers.share": 1.1}, "`outliers.share`"),
        ({"network.delay_mean": -0.1}, "`network.delay_mean`"),
        ({"sensors.range.rate": 0}, "`sensors.range.rate`"),
        ({"sensors.odometry.twist": "average"}, "`sensors.odometry.twist`"),
        ({"trajectory": {"kind": "segments", "segments": []}}, "`trajectory.segments`"),
        ({"trajectory": {"kind": "segments", "segments": [SEGMENT], "turn_radius": 0}}, "above 0"),
        (
            {
                "trajectory": {
                    "kind": "segments",
                    "segments": [SEGMENT | {"omega": -0.42}],
                    "turn_radius": 1.2,
                }
            },
            "omega = -0.42 at v = 0.5 turns more tightly than turn_radius = 1.2",
        ),
        (
            {
                "trajectory": {
                    "kind": "segments",
                    "segments": [SEGMENT | {"omega": 0.4}, SEGMENT | {"v": -0.5}],
                    "turn_radius": 1.2,
                }
            },
            "a car stops before it drives back",
        ),
        ({"network.batch": -0.1}, "`network.batch`"),
        ({"network.clock_sd": -0.1}, "`network.clock_sd`"),
        ({"network.recorder": "1"}, "`network.recorder`"),
        ({"sensors.range.rate_spread": 1.0}, "`sensors.range.rate_spread`"),
        ({"sensors.range.phase": "none"}, "`sensors.range.phase`"),
        ({"sensors.odometry.at_rest": 1.5}, "`sensors.odometry.at_rest`"),
        ({"sensors.odometry.gaps.share": 1.0}, "`sensors.odometry.gaps.share`"),
        ({"sensors.odometry.gaps.length": 0}, "`sensors.odometry.gaps.length`"),
        ({"sensors.odometry.scale_sd": -1}, "`sensors.odometry.scale_sd`"),
        (
            {"trajectory": {"kind": "segments", "segments": [SEGMENT], "ramp": 2.0}},
            "ramp is longer than a segment",
        ),
        ({"trajectory.kind": "flying"}, "kind must be wander"),
    ],
)
def test_bad_scenarios_are_refused_in_one_line(overrides, text):
    found = refused(overrides)
    assert text in found
    assert "\n" not in found


def test_precedence(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\nduration = 5\nseed = 3\n[team]\nmoving = 2\nstatic = 1\n')
    assert load_scenario(str(path)).seed == 3
    assert load_scenario(str(path), environment={"seed": 4}).seed == 4
    assert load_scenario(str(path), {"seed": 5}, {"seed": 4, "duration": 6}).seed == 5
    assert load_scenario(str(path), {"seed": 5}, {"seed": 4, "duration": 6}).duration == 6.0


def test_faults_name_their_origin(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\nduration = 5\n[team]\nmoving = 2\n')
    with pytest.raises(UsageError, match=r"mine\.toml: `team\.static`: is missing"):
        load_scenario(str(path))
    with pytest.raises(UsageError, match=r"^environment: `seed`"):
        load_scenario("shi-sim", environment={"seed": -1})


@pytest.mark.parametrize(
    ("source", "text"),
    [
        ("shi_sim", "shi_sim: no such scenario, did you mean `shi-sim`?"),
        ("zzzzzz", "zzzzzz: no such scenario; known: "),
        ("none.toml", "none.toml: no such scenario file"),
        ("no/where", "no/where: no such scenario file"),
    ],
)
def test_no_such_scenario(source, text):
    with pytest.raises(UsageError) as caught:
        load_scenario(source)
    assert str(caught.value).startswith(text)


@pytest.mark.parametrize(
    "overrides",
    [
        {},
        {"sensors.range.pairs": [["R1", "R3"]], "sensors.range.max_range": 5.0},
        {"trajectory": {"kind": "segments", "segments": [SEGMENT, SEGMENT], "repeat": True}},
        {"robots": [{"name": "A", "start": [1, 2, 3], "trajectory": {"kind": "circle"}},
                    {"name": "B", "static": True, "position": [1, 1]}]},
        {"description": parse_literal('"quotes \\" and lines \\n"'), "seed": 2**62 + 1},
        {"sensors.range.sigma": 0.1 + 0.2, "outliers.mean": 1e-17},
        {"network.batch": 0.03, "network.clock_mean": -0.002, "network.recorder": "R3"},
        {"sensors.odometry.gaps.share": 0.1, "sensors.odometry.at_rest": 0.0,
         "sensors.odometry.phase": "random", "sensors.range.rate_spread": 0.1},
        {"trajectory": {"kind": "segments", "segments": [SEGMENT], "turn_radius": 1.2}},
    ],
)  # fmt: skip
def test_effective_toml_is_the_scenario(overrides, tmp_path):
    scenario = load_scenario("shi-sim", overrides)
    path = tmp_path / "effective.toml"
    path.write_bytes(effective_toml(scenario).encode())
    assert load_scenario(str(path)) == scenario


def test_an_imperfection_is_written_out_where_a_scenario_has_it():
    keys = {"network.clock_sd": 0.009, "sensors.odometry.gaps": {"share": 0.1}}
    written = effective_toml(load_scenario("shi-sim", keys))
    assert "clock_sd = 0.009" in written
    assert "[sensors.odometry.gaps]" in written
    assert "batch" not in written
    assert "gaps" not in effective_toml(load_scenario("shi-sim"))
