"""What an export had to leave out or assume, in words."""

from __future__ import annotations

from clt.cli.messages.words import Texts

EXPORT_TEXTS: Texts = {
    "not_in_graph": "{count} of {total} ranges are left out of the graph: no pose or known place "
    "at their time for one of {subject}",
    "graph_cut": "{subject}: {count} of {total} odometry samples are left out of the graph: they "
    "lie outside the time of its truth",
    "graph_range_noise_assumed": "the log does not state the noise of its ranges: the graph has "
    "{sigma_m} m",
    "graph_odometry_noise_assumed": "the log does not state the odometry noise of {subject}: the "
    "graph has {sigma} m/s and rad/s",
    "graph_from_odometry": "{subject} has no truth with headings: its vertices are the odometry "
    "alone, from the origin",
}
