from __future__ import annotations

import gzip

import numpy as np
import pytest

from clt.core.errors import LogError
from clt.importers.textfile import parse_stamp, read_rows, read_words
from clt.log.faults import Faults


@pytest.mark.parametrize(
    ("word", "stamp"),
    [
        ("7", 7_000_000_000),
        ("1248444175.103", 1_248_444_175_103_000_000),
        ("1248362857.700000048", 1_248_362_857_700_000_048),
        ("0.1234567899", 123_456_789),
        ("  3.1520999953941681e+003".strip(), 3_152_099_995_394),
        ("2147483648", None),
        ("-1.0", None),
        ("nan", None),
        ("1e400", None),
        ("then", None),
        ("", None),
    ],
)
def test_stamps_are_read_digit_by_digit(word, stamp):
    assert parse_stamp(word) == stamp


def test_rows_are_sorted_and_counted(tmp_path):
    path = tmp_path / "t.txt.gz"
    text = "# a comment\n2.0 1 2 spare\n\n1.0\t3 4\nx 1 2\n3.0 1\n4.0 nan 2\n5.0 1 2m\n"
    path.write_bytes(gzip.compress(text.encode(), mtime=0))
    faults = Faults("t")
    rows = read_rows(path, 2, "a time and two numbers", faults)
    assert rows.stamp.tolist() == [1_000_000_000, 2_000_000_000]
    assert rows.values.tolist() == [[3.0, 4.0], [1.0, 2.0]]
    found = {fault.kind: (fault.count, fault.data_lost) for fault in faults.all()}
    assert found == {"row": (3, True), "nan": (1, True), "backwards": (1, False)}
    assert "line 5: 3 lines not a time and two numbers; dropped" in faults.all()[0].text


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "no line holds a row"),
        (b"x y\n", "no line holds a row"),
        (b"\xff\xfe\x00\n", "not a text file"),
        (b"\x00" * 70_000, "line 1: longer than a line"),
        (gzip.compress(b"1.0 2.0\n" * 99, mtime=0)[:25], "a damaged gzip file"),
    ],
)
def test_one_line_for_what_is_no_table(tmp_path, data, said):
    path = tmp_path / "t.dat"
    path.write_bytes(data)
    with pytest.raises(LogError, match=said) as caught:
        read_rows(path, 1, "a row", Faults("t"))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file(tmp_path):
    with pytest.raises(LogError, match="No such file"):
        list(read_words(tmp_path / "nowhere"))


def test_columns_are_plain_numbers(tmp_path):
    path = tmp_path / "t.dat"
    path.write_text("1 2\n")
    rows = read_rows(path, 1, "a row", Faults("t"))
    assert (rows.stamp.dtype, rows.values.dtype) == (np.int64, np.float64)
