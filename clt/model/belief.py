"""What a filter knows at one instant, and how a start becomes that.

A belief is a weighted set of Gaussians: a Kalman filter has one, a mixture several, a particle
filter many without width.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats
from clt.core.geometry import is_heading_unknown, wrap_angle
from clt.core.start import Start
from clt.model.state_space import poses_to_blocks, samples_to_blocks

MAX_NEGATIVE_VARIANCE = 1e-9
"""Below zero by no more than this, a variance is zero, m^2 or rad^2."""


class Belief(NamedTuple):
    """Weighted Gaussians over a state of N numbers."""

    log_weight: Floats
    """Normalized, shape (K,)."""
    mean: Floats
    """(K, N)."""
    covariance: Floats
    """(K, N, N); (K, 0, 0) for particles, which have no width."""


@dataclass(frozen=True)
class Prior:
    """Joint Gaussians of n poses in one frame, and which blocks a state takes from them."""

    probability: Floats
    """(K,), sums to one, the largest first."""
    mean: Floats
    """(K, n, 3), m and rad."""
    covariance: Floats
    """(K, 3n, 3n)."""
    who: tuple[int, ...]
    """Pose of each block."""
    base: tuple[int, ...]
    """Pose in whose frame it stands, or `state_space.WORLD_REFERENCE`."""
    calibration: tuple[float, ...] = ()
    """Standard deviations of the odometry errors in the state, three of each driver that has them
    there (`state_space.corrected_twist`)."""
    places: tuple[int, ...] = ()
    """Poses of robots that stand and of whose heading nothing is known, nor ever will be."""


def make_prior(
    start: Start,
    names: Sequence[str],
    who: Sequence[int],
    base: Sequence[int],
    calibration: tuple[float, ...] = (),
    still: Collection[str] = (),
) -> Prior:
    """The prior of the named robots, of which some stand `still`, from a start's hypotheses."""
    sets = [{**start.poses, **hypothesis.poses} for hypothesis in start.hypotheses]
    shares = [hypothesis.probability for hypothesis in start.hypotheses]
    sets, shares = (sets, shares) if len(sets) > 0 else ([dict(start.poses)], [1.0])
    n = len(names)
    covariance = np.zeros((len(sets), 3 * n, 3 * n))
    for k, poses in enumerate(sets):
        for i, name in enumerate(names):
            own = slice(3 * i, 3 * i + 3)
            covariance[k, own, own] = poses[name].covariance
    mean = np.array([[poses[name].mean for name in names] for poses in sets], np.float64)
    probability = np.array(shares, np.float64)
    places = tuple(
        i
        for i, name in enumerate(names)
        if name in still and np.all(is_heading_unknown(covariance[:, 3 * i + 2, 3 * i + 2]))
    )
    return Prior(
        probability / probability.sum(),
        mean,
        covariance,
        tuple(who),
        tuple(base),
        calibration,
        places,
    )


def belief_from_prior(prior: Prior) -> Belief:
    """The prior in the blocks, first order around each mean; calibration errors begin at zero."""
    blocks = [
        poses_to_blocks(mean, covariance, prior.who, prior.base)
        for mean, covariance in zip(prior.mean, prior.covariance, strict=True)
    ]
    errors = np.array(prior.calibration, np.float64)
    N = 3 * len(prior.who)
    mean = np.zeros((len(blocks), N + errors.size))
    covariance = np.zeros((len(blocks), N + errors.size, N + errors.size))
    for k, (x, P) in enumerate(blocks):
        mean[k, :N], covariance[k, :N, :N] = x, P
        covariance[k, N:, N:] = np.diag(errors**2)
    return Belief(np.log(prior.probability), mean, covariance)


def sample_prior(prior: Prior, count: int, draw: np.random.Generator) -> Floats:
    """Samples of the state from the prior, shape (count, N): exact, also where it is wide.

    Headings of `places` are not drawn: no range would ever weigh them.
    """
    which = draw.choice(prior.probability.size, size=count, p=prior.probability)
    n = prior.mean.shape[1]
    unit = draw.standard_normal((count, 3 * n))
    covariance = prior.covariance.copy()
    for i in prior.places:
        covariance[:, 3 * i + 2, :] = covariance[:, :, 3 * i + 2] = 0.0
    roots = np.array([covariance_square_root(P) for P in covariance])
    poses = prior.mean[which] + np.einsum("kij,kj->ki", roots[which], unit).reshape(count, n, 3)
    blocks = samples_to_blocks(poses, prior.who, prior.base)
    errors = np.array(prior.calibration, np.float64)
    return np.concatenate([blocks, errors * draw.standard_normal((count, errors.size))], axis=1)


def covariance_square_root(P: Floats) -> Floats:
    """A matrix L with L L^T = P for a covariance P (N, N), also where it is singular."""
    values, vectors = np.linalg.eigh(P)
    root: Floats = vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def belief_block_moments(belief: Belief, block: int) -> tuple[Floats, Floats]:
    """Mean (3,) and covariance (3, 3) of one block over all of a belief, on the circle."""
    own = slice(3 * block, 3 * block + 3)
    w, x = np.exp(belief.log_weight), belief.mean[:, own]
    about = x[np.argmax(w)].copy()
    about[2] = np.angle(w @ np.exp(1j * x[:, 2]))
    d = x - about
    d[:, 2] = wrap_angle(d[:, 2])
    middle = w @ d
    d = d - middle
    P = np.einsum("k,ki,kj->ij", w, d, d)
    if belief.covariance.shape[1] > 0:
        P += np.einsum("k,kij->ij", w, belief.covariance[:, own, own])
    mean = about + middle
    mean[2] = wrap_angle(mean[2])
    return mean, P


def is_valid_covariance(covariance: Floats) -> bool:
    """Whether covariances (n, 3, 3) hold numbers, and no variance below zero beyond rounding."""
    variances = np.diagonal(covariance, axis1=-2, axis2=-1)
    return bool(np.isfinite(covariance).all() and np.all(variances >= -MAX_NEGATIVE_VARIANCE))


def state_mean_and_sigma(belief: Belief, index: int) -> tuple[float, float]:
    """Mean and standard deviation of one number of the state over all of a belief."""
    w, x = np.exp(belief.log_weight), belief.mean[:, index]
    mean = float(w @ x)
    variance = float(w @ (x - mean) ** 2)
    if belief.covariance.shape[1] > 0:
        variance += float(w @ belief.covariance[:, index, index])
    return mean, variance**0.5
