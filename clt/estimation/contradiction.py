"""What is likely wrong with a log whose ranges contradict each other before any filter has run."""

from __future__ import annotations

import numpy as np

from clt.core.errors import CltError
from clt.core.recording import Recording
from clt.core.start import InitialPose, Start
from clt.estimation.causes import NOISE_FACTORS, Cause
from clt.estimation.estimators import DEFAULT_ESTIMATOR
from clt.estimation.nis_check import CauseSearch, explain_misfit
from clt.initialization.status import Initialization
from clt.model.problem import build_problem
from clt.model.settings import FilterSettings

GUESS = (0.3, 0.3, 0.2)
"""How well a guessed pose is believed, m, m, rad: as narrow as a place to linearize at must be."""
LEAST_BASELINE = 0.1
"""Two anchors whose distance is off by less, m, are no cause."""


def cause_of(recording: Recording, found: Initialization, settings: FilterSettings) -> Cause | None:
    """The cause that best explains the residuals of a run from the guessed poses; None: unknown."""
    guess = np.diag(np.square(np.array(GUESS)))
    poses = {
        name: robot.pose
        if robot.status == "ok"
        else InitialPose(robot.pose.mean, robot.pose.covariance + guess)
        for name, robot in found.robots.items()
        if robot.pose is not None
    }
    try:
        problem = build_problem(
            recording, Start(found.stamp, poses, found.frame), settings, DEFAULT_ESTIMATOR.view
        )
    except CltError:
        return None
    trial = CauseSearch(
        problem, DEFAULT_ESTIMATOR.run(problem, settings), settings, recording.ranges.source
    )
    cause = explain_misfit(trial, recording.team.names, gross=True)
    if cause is None or (cause.kind.endswith("noise") and cause.value >= NOISE_FACTORS[-1]):
        return None  # Noise without bound explains everything, and nothing.
    return baseline(cause, recording, found) if cause.kind == "anchor" else cause


def baseline(cause: Cause, recording: Recording, found: Initialization) -> Cause | None:
    """An anchor that is elsewhere, in a frame whose guesses hang on the anchors themselves.

    Where these are two, only their distance shows, whichever of them it is.
    """
    static = recording.team.static
    held = [robot for robot in static if found.robots[robot.name].status == "ok"]
    if len(held) != 2 or cause.place is None:
        return cause
    names = tuple(robot.name for robot in held)
    places = {name: found.robots[name].pose for name in names}
    (other,) = (name for name in names if name not in cause.who)
    here, there = places[cause.who[0]], places[other]
    if here is None or there is None:
        return cause
    stated = float(np.hypot(*(here.mean[:2] - there.mean[:2])))
    longer = float(np.hypot(*(np.array(cause.place) - there.mean[:2]))) - stated
    return Cause("baseline", names, longer) if abs(longer) >= LEAST_BASELINE else None
