"""The layout of a team that stands still throughout, from all its ranges.

Nobody drives, so there is no heading to find: what remains of the motion-induced initialization
(Shi) is its first half, positions by scaling the mean distances.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.core.arrays import Floats
from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError
from clt.core.recording import WORLD_FRAME, Recording
from clt.initialization.motion.layout import (
    AlternativeLayout,
    TeamLayout,
    estimate_layout,
    reflect_at_line,
)
from clt.initialization.motion.lines import are_collinear, farthest_pair, not_all_coincident
from clt.initialization.motion.places import PossiblePosition
from clt.initialization.motion.realizations import UNSEARCHED
from clt.initialization.motion.robot_status import (
    LAYOUT_PART_MIRRORED,
    TOO_FEW_RANGES,
    status_of_positions,
)
from clt.initialization.pair_distances import mean_distances
from clt.initialization.status import Initialization, RobotStatus, unobservable_status
from clt.model.settings import FilterSettings


def from_static(recording: Recording, settings: FilterSettings) -> Initialization:
    """Positions of a team of static robots, at its first range.

    Headings stand at 0, as for every static robot. In Shi's frame the side is a convention; beside
    the line of surveyed robots it is not, and who stands there is ambiguous. Raises CltError where
    no two robots measured each other.
    """
    team, stamp = recording.team, recording.ranges.stamp
    known = {i: np.array(r.position) for i, r in enumerate(team.robots) if r.position is not None}
    surveyed = len(known) >= 2 and not_all_coincident(list(known.values()))
    known = known if surveyed else {}
    count = len(team.robots)
    if count < 2 or stamp.size == 0:
        raise CltError("no two static robots measured each other: there is nothing to lay out")
    begin = int(stamp[0])
    pairs = mean_distances(recording, range(count), begin - 1, int(stamp[-1]), settings.noise)
    found = estimate_layout(pairs, count, known)
    off = float(np.sqrt(np.mean(found.residual[found.used] ** 2)))
    residual = {"count": int(found.used.sum()), "rms_m": off}
    notes = [Diagnostic("layout_residual", values=residual)]
    if (left := int(np.count_nonzero(~found.used))) > 0:
        notes.append(Diagnostic("distances_left_out", values={"count": left}))
    on_a_line = not surveyed or are_collinear(list(known.values()))
    if on_a_line and count > max(len(known), 2):
        notes.append(Diagnostic("layout_side_unknown"))
    axis = farthest_pair(list(known.values())) if surveyed and on_a_line else None
    robots = {name: _status(found, i, axis) for i, name in enumerate(team.names)}
    frame = team.frame if surveyed else WORLD_FRAME
    return Initialization(begin, surveyed, robots, tuple(notes), frame=frame)


def _status(layout: TeamLayout, i: int, axis: tuple[Floats, Floats] | None) -> RobotStatus:
    """One robot; its mirror image at the `axis`, two points (2,), is as good."""
    if not layout.rigid[i]:
        return unobservable_status(TOO_FEW_RANGES)
    part = slice(2 * i, 2 * i + 2)
    first = AlternativeLayout(layout.position, layout.covariance, layout.probability)
    places = [
        PossiblePosition(one.position[i], one.covariance[part, part], one.probability)
        for one in (first, *layout.others)
    ]
    if axis is not None:
        along = (axis[1] - axis[0]) / np.hypot(*(axis[1] - axis[0]))
        flip = 2.0 * np.outer(along, along) - np.eye(2)
        places += [
            replace(
                p,
                position=reflect_at_line(p.position, *axis),
                covariance=flip @ p.covariance @ flip,
            )
            for p in places
        ]
    part_open = len(layout.others) > 0
    found = status_of_positions(
        places, LAYOUT_PART_MIRRORED if part_open else Diagnostic("layout_side_open")
    )
    if layout.searched or not places[0].covariance.any():
        return found
    return replace(found, status="ambiguous", why=UNSEARCHED)
