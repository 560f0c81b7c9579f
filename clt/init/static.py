"""The layout of a team that stands still throughout, from all its ranges.

Nobody drives, so there is no heading to find: what remains of the motion-induced initialization
(Shi) is its first half, positions by scaling the mean distances.
"""

from __future__ import annotations

import numpy as np

from clt.errors import CltError
from clt.filters.settings import FilterSettings
from clt.init.frame import apart, on_one_line
from clt.init.layout import Layout, lay_out
from clt.init.pairs import mean_distances
from clt.init.start import InitialPose
from clt.streams import Recording

MIRROR = "ranges alone do not tell this layout from its mirror image"


def from_static(
    recording: Recording, settings: FilterSettings
) -> tuple[int, dict[str, InitialPose | None], bool, tuple[str, ...]]:
    """Positions of a team of static robots: stamp (ns), poses, whether surveyed, and notes.

    Headings stand at 0, as for every static robot; None where too few ranges place a robot.
    Raises CltError where no two robots measured each other.
    """
    team, stamp = recording.team, recording.ranges.stamp
    known = {i: np.array(r.position) for i, r in enumerate(team.robots) if r.position is not None}
    surveyed = len(known) >= 2 and apart(list(known.values()))
    known = known if surveyed else {}
    count = len(team.robots)
    if count < 2 or stamp.size == 0:
        raise CltError("no two static robots measured each other: there is nothing to lay out")
    begin = int(stamp[0])
    pairs = mean_distances(recording, range(count), begin - 1, int(stamp[-1]), settings.noise)
    found = lay_out(pairs, count, known)
    poses = {name: _pose(found, i) if found.rigid[i] else None for i, name in enumerate(team.names)}
    off = float(np.sqrt(np.mean(found.residual[found.used] ** 2)))
    notes = [f"the layout misses {int(found.used.sum())} mean distances by {off:.3f} m rms"]
    if (left := int(np.count_nonzero(~found.used))) > 0:
        notes.append(f"{left} mean distance(s) contradict the others: left out")
    on_a_line = not surveyed or on_one_line(list(known.values()))
    if on_a_line and count > max(len(known), 2):
        notes.append(MIRROR)
    return begin, poses, surveyed, tuple(notes)


def _pose(layout: Layout, i: int) -> InitialPose:
    covariance, part = np.zeros((3, 3)), slice(2 * i, 2 * i + 2)
    covariance[:2, :2] = layout.covariance[part, part]
    return InitialPose(np.append(layout.position[i], 0.0), covariance)
