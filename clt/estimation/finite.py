"""A posterior without what is no number: nothing else of it is lost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats
from clt.core.diagnostics import DIVERGED, Diagnostic
from clt.core.recording import Innovations, Poses
from clt.estimation.posterior import Posterior, add_diagnostics
from clt.model.belief import MAX_NEGATIVE_VARIANCE

MAX_MAGNITUDE = 1e12
"""m, rad and squares of them: nothing that is estimated is larger."""


def finite_rows(*columns: Floats) -> NDArray[np.bool_]:
    """Rows (n,) where all numbers of columns (n, ...) are finite and at most MAX_MAGNITUDE."""
    good = [
        (np.abs(np.nan_to_num(c, nan=np.inf)) <= MAX_MAGNITUDE).all(axis=tuple(range(1, c.ndim)))
        for c in columns
    ]
    return np.asarray(np.logical_and.reduce(good))


def finite_poses(poses: Poses) -> tuple[Poses, int]:
    """The rows of an estimate that hold numbers throughout, and how many others there are.

    A variance below zero, as rounding leaves where all certainty was lost, is none.
    """
    covariance = poses.covariance
    if covariance is None:
        return poses, 0
    keep = finite_rows(poses.x, poses.y, poses.heading, covariance)
    keep &= np.all(np.diagonal(covariance, axis1=1, axis2=2) >= -MAX_NEGATIVE_VARIANCE, axis=1)
    if keep.all():
        return poses, 0
    columns = {
        name: getattr(poses, name)[keep] for name in ("stamp", "log_time", "x", "y", "heading")
    }
    return replace(poses, covariance=covariance[keep], **columns), int(np.sum(~keep))


def finite_innovations(innovations: Innovations) -> tuple[Innovations, int]:
    """The rows that hold numbers throughout, and how many others there are."""
    keep = finite_rows(innovations.residual, innovations.sigma) & np.isfinite(innovations.nis)
    if keep.all():
        return innovations, 0
    columns = {name: column[keep] for name, column in vars(innovations).items()}
    return Innovations(**columns), int(np.sum(~keep))


def keep_finite(posterior: Posterior) -> Posterior:
    """The posterior with only the rows that hold numbers; the others are counted.

    Robots that lose any have diverged; those that lose all have no trajectory.
    """
    poses: dict[str, Poses] = {}
    found: list[Diagnostic] = []
    for name, track in posterior.poses.items():
        kept, lost = finite_poses(track)
        if lost > 0:
            counts = {"count": lost, "total": int(track.x.size)}
            found.append(Diagnostic("estimates_not_finite", name, "partial", counts))
            if name not in posterior.diverged:
                found.append(Diagnostic(DIVERGED, name, "partial"))
        if kept.stamp.size > 0:
            poses[name] = kept
    innovations, lost = finite_innovations(posterior.innovations)
    if lost > 0:
        counts = {"count": lost, "total": int(posterior.innovations.stamp.size)}
        found.append(Diagnostic("innovations_not_finite", "", "partial", counts))
    return add_diagnostics(replace(posterior, poses=poses, innovations=innovations), found)
