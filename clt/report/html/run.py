"""One log of a report: what the page draws of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clt.core.errors import CltError
from clt.core.recording import Recording
from clt.metrics.evaluation import Evaluation
from clt.observability.windows.windows import WindowAnalysis
from clt.report.figures import plain
from clt.report.figures.figure import evaluation_subtitle, evaluation_title


@dataclass(frozen=True)
class ReportRun:
    """A log, its figures if it has truth, and its windows if they could be analysed."""

    name: str
    """Of the log, for people."""
    recording: Recording
    evaluation: Evaluation | None
    windows: WindowAnalysis | None = None
    windows_note: str = ""
    """Why there are none."""
    warnings: Sequence[str] = ()
    """Lines on what was found out."""

    @property
    def title(self) -> str:
        """The team's figures in one line, or what is seen."""
        if self.evaluation is None:
            return plain.unscored_title(self.recording)
        return evaluation_title(self.evaluation)

    @property
    def subtitle(self) -> str:
        """What was compared, and how."""
        if self.evaluation is None:
            return plain.unscored_subtitle(self.recording)
        return evaluation_subtitle(self.recording, self.evaluation)

    @property
    def span(self) -> tuple[int, int]:
        """First and last stamp of what is drawn, ns. Raises CltError where nothing is."""
        recording = self.recording
        stamps = [track.stamp for track in recording.estimate.values()]
        if len(stamps) == 0:
            stamps += [stream.stamp for stream in recording.odometry.values()]
            stamps += [recording.ranges.stamp, *(one.stamp for one in recording.truth.values())]
        stamps = [stamp for stamp in stamps if stamp.size > 0]
        if len(stamps) == 0:
            raise CltError("nothing to draw: neither estimates nor odometry, ranges or truth")
        begin = min(int(stamp[0]) for stamp in stamps)
        return begin, max(int(np.max(stamp)) for stamp in stamps)
