from datetime import date
from typing import Annotated, Literal

import pytest
from pydantic import Field

from clt.core.errors import UsageError
from clt.core.settings import (
    Settings,
    did_you_mean,
    known_keys,
    parse_assignments,
    parse_literal,
    parse_settings,
    read_toml,
    refuse_unknown_variables,
    set_dotted_key,
    settings_from_environment,
)


class Round(Settings):
    kind: Literal["round"] = "round"
    radius: float = 1.0


class Square(Settings):
    kind: Literal["square"] = "square"
    side: float = 1.0


class Part(Settings):
    weight: float


class Body(Settings):
    mass: Annotated[float, Field(gt=0.0)] = 1.0
    count: int = 1
    shape: Annotated[Round | Square, Field(discriminator="kind")] = Round()
    parts: tuple[Part, ...] = ()
    choice: Literal["a", "b"] | tuple[tuple[str, str], ...] = "a"


class Top(Settings):
    name: str = "x"
    body: Body = Body()


def refusal(data):
    with pytest.raises(UsageError) as caught:
        parse_settings(Top, data, "here")
    text = str(caught.value)
    assert caught.value.code == 2
    assert "\n" not in text
    return text


@pytest.mark.parametrize(
    ("data", "text"),
    [
        ({"nam": "y"}, "here: unknown key `nam`, did you mean `name`?"),
        ({"body": {"mas": 1}}, "here: unknown key `body.mas`, did you mean `mass`?"),
        ({"qqq": 1}, "here: unknown key `qqq`; known: body, name"),
        (
            {"body": {"shape": {"kind": "round", "radus": 1}}},
            "here: unknown key `body.shape.radus`, did you mean `radius`?",
        ),
        (
            {"body": {"shape": {"kind": "square", "radius": 1}}},
            "here: unknown key `body.shape.radius`; known: kind, side",
        ),
        (
            {"body": {"parts": [{"weight": 1}, {"weight": 1, "weigth": 1}]}},
            "here: unknown key `body.parts.1.weigth`, did you mean `weight`?",
        ),
        ({"body": {"shape": {"radius": 1}}}, "here: `body.shape.kind` is missing"),
    ],
)
def test_unknown_keys_are_refused_with_the_nearest_named(data, text):
    assert refusal(data) == text


@pytest.mark.parametrize(
    ("data", "start"),
    [
        ({"body": {"mass": "heavy"}}, '`body.mass`: must be a number, not "heavy"'),
        ({"body": {"mass": [1]}}, "`body.mass`: must be a number, not a list of 1"),
        ({"body": {"mass": 0}}, "`body.mass`: must be above 0, not 0"),
        ({"body": {"mass": float("nan")}}, "`body.mass`: must be a finite number, not nan"),
        ({"body": {"mass": float("inf")}}, "`body.mass`: must be a finite number, not inf"),
        ({"body": {"count": 1.5}}, "`body.count`: must be a whole number, not 1.5"),
        ({"body": 3}, "`body`: must be a table, not 3"),
        ({"name": date(2020, 1, 2)}, "`name`: must be text, not a date"),
        ({"name": 10**5000}, "`name`: must be text, not so large a number"),
        (
            {"body": {"shape": {"kind": "ruond"}}},
            '`body.shape`: kind must be round or square, not "ruond"; did you mean `round`?',
        ),
        (
            {"body": {"shape": {"kind": "square", "side": "x" * 1000}}},
            f'`body.shape.side`: must be a number, not "{60 * "x"}..."',
        ),
        ({"body": {"parts": [{}]}}, "`body.parts.0.weight`: is missing"),
        ({"body": {"choice": "c"}}, '`body.choice`: must be a or b, not "c"'),
        ({"body": {"choice": [["p"]]}}, "`body.choice.0`: needs 2 values at least"),
        ({"body": {"choice": [["p", "q", "r"]]}}, "`body.choice.0`: must have at most 2 items"),
    ],
)
def test_bad_values_name_their_key_in_our_own_words(data, start):
    assert refusal(data) == f"here: {start}"


def test_known_keys_hold_the_keys_of_every_choice_but_of_no_list():
    assert set(known_keys(Top)) == {
        "name", "body", "body.mass", "body.count", "body.shape", "body.shape.kind",
        "body.shape.radius", "body.shape.side", "body.parts", "body.choice",
    }  # fmt: skip


def test_environment():
    found = settings_from_environment(
        Top, {"CLT_BODY__MASS": "2.5", "CLT_NAME": "word", "CLT_OTHER__KEY": "1", "HOME": "/"}
    )
    assert found == {"body.mass": 2.5, "name": "word"}


@pytest.mark.parametrize(
    ("variable", "hint"),
    [
        ("CLT_BODY__MAS", ", did you mean `CLT_BODY__MASS`?"),
        ("CLT_QQQ", ""),
        ("CLT_", ""),
        ("CLT_name", ""),
    ],
)
def test_unknown_variables_are_refused_with_at_most_the_nearest_named(variable, hint):
    with pytest.raises(UsageError) as caught:
        refuse_unknown_variables([Body, Top], {variable: "1", "CLT_NAME": "x", "HOME": "/"})
    assert str(caught.value) == f"environment variable {variable}: unknown key{hint}"
    refuse_unknown_variables([Body, Top], {"CLT_MASS": "1", "CLT_NAME": "x", "HOME": "/"})


@pytest.mark.parametrize("depth", [300, 5000, 100000])
def test_values_nested_too_deeply_are_refused(tmp_path, depth):
    deep = depth * "[" + depth * "]"
    path = tmp_path / "deep.toml"
    path.write_text(f"name = {deep}")
    for build in (
        lambda: read_toml(path),
        lambda: parse_assignments([f"name={deep}"]),
        lambda: settings_from_environment(Top, {"CLT_NAME": deep}),
    ):
        with pytest.raises(UsageError) as caught:
            parse_settings(Top, build(), "here")
        text = str(caught.value)
        assert (
            "`name`: must be text, not a list of 1" in text
            if depth == 300
            else text.endswith("nested too deeply")
        )
        assert len(text) < 200


@pytest.mark.parametrize(
    ("text", "value"),
    [("3", 3), (5000 * "9", 5000 * "9"),
     ("1\nx = 2", "1\nx = 2"), ("0.1", 0.1), ("true", True), ("[1, 2]", [1, 2]),
     ("word", "word"), ("", ""), ('"3"', "3"), ("a b", "a b"), ("{x = 1}", {"x": 1})],
)  # fmt: skip
def test_literals(text, value):
    assert parse_literal(text) == value


def test_assignments():
    assert parse_assignments(["a.b=3", "c = x=y", "a.b=4"]) == {"a.b": 4, "c": "x=y"}
    for bad in ("a", "=3", " =3"):
        with pytest.raises(UsageError, match="KEY=VALUE"):
            parse_assignments([bad])


def test_assigning_makes_tables_and_keeps_values():
    tree = {"a": {"x": 1}, "n": 3}
    set_dotted_key(tree, "a.y", 2)
    set_dotted_key(tree, "b.c.d", 4)
    assert tree == {"a": {"x": 1, "y": 2}, "n": 3, "b": {"c": {"d": 4}}}
    with pytest.raises(UsageError, match="n is not a table"):
        set_dotted_key(tree, "n.x", 1)


def test_nearest_is_silent_without_known_words():
    assert did_you_mean("x", []) == ""


def test_reading_toml(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text("a = 1\nb = = 2\n")
    with pytest.raises(UsageError, match=r"a\.toml: not valid TOML: .*line 2"):
        read_toml(path)
    path.write_bytes(b"a = '\xff'")
    with pytest.raises(UsageError, match="not valid TOML"):
        read_toml(path)
    with pytest.raises(UsageError, match=r"b\.toml: No such file"):
        read_toml(tmp_path / "b.toml")
    path.write_text("a = 1")
    assert read_toml(path) == {"a": 1}
