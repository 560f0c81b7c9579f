"""Which encapsulations are plain CDR, and where fields lie."""

from __future__ import annotations

import pytest

from clt.log.cdr.msgdef import parse_definition
from clt.log.cdr.reader import CdrError, StepBudget, locate_fields
from tests.log.logs import Cdr

POINT = "float64 x\nuint8 flag\nfloat64 y\nstring name\n"


def located(message, wanted=("x", "y", "name")):
    return locate_fields(parse_definition("test_msgs/msg/P", POINT), message, wanted, StepBudget())


def payload(order="<"):
    return Cdr(order).put("d", 1.5).put("B", 7).put("d", -2.0).text("ab").done()


@pytest.mark.parametrize("order", ["<", ">"])
def test_plain_cdr_of_either_order_is_located(order):
    found = located(payload(order))
    assert found.order == order
    assert found.spots["x"].offset == 4
    # Eight bytes of x, one of the flag and seven of padding.
    assert found.spots["y"].offset == 4 + 16
    assert (found.spots["name"].offset, found.spots["name"].count) == (4 + 24 + 4, 2)


@pytest.mark.parametrize("head", [b"\x00\x02", b"\x00\x03", b"\x00\x06", b"\x01\x01", b"\x00\xff"])
def test_other_encapsulations_are_refused(head):
    with pytest.raises(CdrError, match="not plain CDR"):
        located(head + payload()[2:])


@pytest.mark.parametrize("size", [0, 3])
def test_a_message_without_a_head_is_refused(size):
    with pytest.raises(CdrError, match="not plain CDR"):
        located(payload()[:size])


def test_a_message_that_ends_early_or_lacks_a_field_is_refused():
    with pytest.raises(CdrError):
        located(payload()[:22])
    with pytest.raises(CdrError, match="absent"):
        located(payload(), ("x", "nothing"))
