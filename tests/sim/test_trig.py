import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from clt.sim.trig import cos_sin


@given(st.floats(-1e5, 1e5))
def test_agrees_with_the_library(angle):
    cos, sin = cos_sin(np.array(angle))
    assert abs(cos - np.cos(angle)) < 5e-16
    assert abs(sin - np.sin(angle)) < 5e-16


def test_quadrants_and_shape():
    angle = np.arange(-8, 9).reshape(1, 17) * np.pi / 4
    cos, sin = cos_sin(angle)
    assert cos.shape == sin.shape == (1, 17)
    np.testing.assert_allclose(cos, np.cos(angle), atol=4e-16)
    np.testing.assert_allclose(sin, np.sin(angle), atol=4e-16)
