"""Quantiles as scipy.special has them."""

from __future__ import annotations

import pytest
from scipy.special import gammaincinv, ndtri

from clt.metrics.quantiles import chi_square_quantile, normal_quantile

SHARES = (1e-6, 0.001, 0.025, 0.3, 0.5, 0.8, 0.975, 0.999)


@pytest.mark.parametrize("p", SHARES)
def test_normal(p):
    assert normal_quantile(p) == pytest.approx(float(ndtri(p)), rel=1e-14, abs=1e-15)


@pytest.mark.parametrize("freedom", [0.01, 0.3, 1.0, 2.0, 2.5, 3.0, 40.0, 99.5, 3e4, 348005.0])
def test_chi_square_of_any_degrees_of_freedom(freedom):
    ours = [chi_square_quantile(p, freedom) for p in SHARES]
    theirs = [2.0 * float(gammaincinv(0.5 * freedom, p)) for p in SHARES]
    assert ours == pytest.approx(theirs, rel=1e-12, abs=1e-290)
