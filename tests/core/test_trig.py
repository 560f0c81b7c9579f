import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from clt.core.trig import cos_sin


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


@given(st.floats(-1e300, 1e300))
def test_any_finite_angle_gives_a_direction(angle):
    cos, sin = cos_sin(np.array([angle, 0.5]))
    assert abs(cos[0] ** 2 + sin[0] ** 2 - 1.0) < 1e-15
    np.testing.assert_allclose([cos[1], sin[1]], [np.cos(0.5), np.sin(0.5)], rtol=1e-15)


def test_no_angles():
    assert [part.size for part in cos_sin(np.empty(0))] == [0, 0]
