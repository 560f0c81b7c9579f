"""Numbers of the observability along a log: the rank of each window, and how sure it could be."""

from __future__ import annotations

import numpy as np

from clt.observability.windows.windows import (
    OBSERVED_HEADING_SIGMA,
    OBSERVED_POSITION_SIGMA,
    WindowAnalysis,
)
from clt.report.html.encode import Document, encode_floats


def window_document(found: WindowAnalysis, begin: int) -> Document:
    """What the page draws of the windows; time 0 is `begin` (ns). Each stands at its end."""
    shift = (found.start_ns - begin) * 1e-9
    return {
        "time": encode_floats(found.end + shift),
        "length": float(found.end[0] - found.begin[0]),
        "rank": found.rank.tolist(),
        "dimension": found.dimension,
        "frame": found.frame,
        "source": found.source.replace("_", " "),
        "position_limit": OBSERVED_POSITION_SIGMA,
        "heading_limit": float(np.degrees(OBSERVED_HEADING_SIGMA)),
        "robots": {
            name: {
                "position": encode_floats(seen.sigma_position),
                "heading": encode_floats(np.degrees(seen.sigma_heading)),
                "has_heading": not bool(np.isnan(seen.sigma_heading).all()),
                "lost": int(np.count_nonzero(np.isinf(seen.sigma_position))),
                "weakest": seen.words[-1] if len(seen.words) > 0 else "",
            }
            for name, seen in found.robots.items()
        },
    }
