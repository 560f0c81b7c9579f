"""Runs over nothing compile what the true runs need, and no more."""

from __future__ import annotations

import pytest

from clt.estimation.estimators import Estimator, localize_recording
from clt.estimation.rehearsal import rehearse
from clt.filters.kalman.eskf import eskf_kernel
from clt.filters.kalman.ukf import ukf_kernel
from clt.filters.mixture.mixture import mixture_kernel
from clt.initialization.given.truth import from_truth
from clt.model.choices import parse_frame_spec
from clt.model.settings import FilterSettings
from tests.filters.teams import team_recording


@pytest.mark.parametrize("frame", ["world", "ego:R1"])
@pytest.mark.parametrize(
    ("name", "kernel"), [("eskf", eskf_kernel), ("ukf", ukf_kernel), ("mixture", mixture_kernel)]
)
def test_a_rehearsal_compiles_what_the_run_needs(name, kernel, frame):
    recording, settings = team_recording(seed=3, seconds=3.0, noise=0.1), FilterSettings()
    estimator = Estimator(name, parse_frame_spec(frame))
    kernel.code.clear()
    rehearse(recording, settings, estimator)
    assert len(kernel.code) == 1
    localize_recording(
        recording, from_truth(recording, settings.initial.sigma), settings, estimator
    )
    assert len(kernel.code) == 1
