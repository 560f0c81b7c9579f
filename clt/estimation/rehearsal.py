"""A filter run over nothing, for the machine code that it leaves behind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.core.recording import Recording
from clt.core.start import InitialPose, Start
from clt.estimation.estimators import Estimator
from clt.model.filter_inputs import Outputs
from clt.model.problem import build_problem
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings


def rehearse(recording: Recording, settings: FilterSettings, estimator: Estimator) -> None:
    """Run a filter of a recording without ranges and outputs, from a start without meaning.

    Its arguments are of the same kinds as those of the true run, so that its kernel is compiled and
    kept. Raises CltError where nothing could be estimated.
    """
    stamp = min(int(stream.stamp[0]) for stream in recording.odometry.values())
    pose = InitialPose(np.zeros(3), np.diag([1.0, 1.0, 0.01]))
    start = Start(stamp, dict.fromkeys(recording.team.names, pose))
    problem = build_problem(recording, start, settings, estimator.view)
    estimator.run(
        replace(
            problem,
            ranges=RangeTable._make(column[:0] for column in problem.ranges),
            outputs=Outputs._make(column[:0] for column in problem.outputs),
            end=stamp,
        ),
        settings,
    )
