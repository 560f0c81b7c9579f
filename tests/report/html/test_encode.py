from __future__ import annotations

import base64
import json

import numpy as np
import pytest

from clt.report.html.encode import encode_bytes, encode_floats, script_json


def decoded(packed):
    kind = {"f4": "<f4", "f8": "<f8", "u1": "u1"}[packed["dtype"]]
    return np.frombuffer(base64.b64decode(packed["bdata"]), kind)


def test_numbers_come_back():
    values = np.array([[1.5, -2.25], [np.nan, np.inf]])
    packed = encode_floats(values)
    assert packed["dtype"] == "f4"
    assert decoded(packed)[:2].tolist() == [1.5, -2.25]
    assert np.isnan(decoded(packed)[2:]).all()


def test_large_numbers_keep_their_digits():
    """Coordinates of a map projection: single precision would have half a metre."""
    packed = encode_floats(np.array([5_412_345.678, 0.5]))
    assert packed["dtype"] == "f8"
    assert decoded(packed).tolist() == [5_412_345.678, 0.5]


def test_bytes_and_nothing():
    assert decoded(encode_bytes(np.array([0, 3, 255]))).tolist() == [0, 3, 255]
    assert encode_floats(np.empty(0))["bdata"] == ""


def test_a_name_cannot_end_the_script():
    text = script_json({"name": "</script><b>"})
    assert "<" not in text
    assert json.loads(text) == {"name": "</script><b>"}
    with pytest.raises(ValueError, match="not JSON compliant"):
        script_json({"a": float("nan")})
