"""What a user may set about the filters: `clt localize --set KEY=VALUE`, file or environment."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from clt.core.settings import Settings

MAX_SETTING = 1e6
"""Far beyond every sensor and every log; squares of it still leave digits to the rest."""
DEFAULT_GATE = 16.0
"""Largest NIS of a range that filters without a model of outliers accept."""
Positive = Annotated[float, Field(gt=0, le=MAX_SETTING)]
NotNegative = Annotated[float, Field(ge=0, le=MAX_SETTING)]


class NoiseSettings(Settings):
    """What the filter believes of the sensors; None takes what the log has."""

    estimate: bool = True
    """Whether the log decides on what is not set here, from a unique start: the errors of odometry
    by motion, `scale`, `bias`, `sigma_range`, `slow`, `offset`, `outliers.isolated`."""
    sigma_v: Positive | None = None
    """One odometry sample, m/s."""
    sigma_omega: Positive | None = None
    """One odometry sample, rad/s."""
    v_per_v: NotNegative = 0.0
    """Further error of v as a share of |v|, independent from sample to sample (wheel slip)."""
    v_per_omega: NotNegative = 0.0
    """Further error of v by turning, m/s per rad/s."""
    omega_per_v: NotNegative = 0.0
    """Further error of omega by driving, rad/s per m/s."""
    omega_per_omega: NotNegative = 0.0
    """Further error of omega as a share of |omega|."""
    v_per_sqrt_m: NotNegative | None = None
    """Error of the distance driven, m per square root of 1 m: of moving, in place of `sigma_v`."""
    omega_per_sqrt_rad: NotNegative | None = None
    """Error of the angle turned, rad per square root of 1 rad, in place of `sigma_omega`."""
    omega_per_sqrt_m: NotNegative | None = None
    """Error of the heading by driving, rad per square root of 1 m, in place of `sigma_omega`."""
    sigma_range: Positive | None = None
    """One calibrated range, m."""
    scale: NotNegative = 0.0
    """How far off each robot's v may be throughout, as a share of it; beyond 0 it is estimated."""
    scale_omega: NotNegative | None = None
    """How far off each robot's omega may be throughout, as a share of it; None: as `scale`."""
    bias: NotNegative = 0.0
    """How far off each robot's omega may be throughout, rad/s; beyond 0 it is estimated."""
    correlation_time: NotNegative | None = None
    """Of the range error of one pair, s; ranges that come faster count for fewer."""
    slow: NotNegative = 0.0
    """Standard deviation of the slow error of each pair's ranges, m; beyond 0 it is estimated."""
    slow_time: Positive = 10.0
    """Over which a slow range error changes, s."""
    slow_distance: NotNegative = 0.0
    """Distance at which a slow range error has grown by 41 %, m; 0: it is the same at all."""
    offset: NotNegative = 0.0
    """How far off all ranges of a node may be throughout, m; beyond 0 it is estimated."""
    gain: NotNegative = 0.0
    """How far off all ranges may be throughout, as a share of the distance; beyond 0 estimated."""

    @property
    def lasting(self) -> tuple[float, float, float]:
        """Standard deviations of the errors that last: scale of v, of omega, bias (rad/s)."""
        return self.scale, self.scale if self.scale_omega is None else self.scale_omega, self.bias


class OutlierSettings(Settings):
    """Ranges that are not in line of sight, for the Kalman filters."""

    share: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """Of the time that a pair is blocked."""
    duration: Positive = 3.0
    """For how long at a time on average, s."""
    isolated: Annotated[float, Field(ge=0, lt=1)] = 0.05
    """Share of outliers that come alone."""
    mean: Positive = 0.5
    """Of an outlier, m."""


class InitialPoseSettings(Settings):
    """How well the initial poses are believed where their source does not say."""

    sigma: tuple[NotNegative, NotNegative, NotNegative] = (0.01, 0.01, 0.01)
    """x, y in m and heading in rad, for `--init truth`."""


class ReplaySettings(Settings):
    """What a replay in the order of arrival does."""

    lag: Annotated[float, Field(ge=0, le=10)] = 1.0
    """How late a measurement may arrive to be fused all the same, at its own stamp, s."""


class UkfSettings(Settings):
    """Merwe's sigma points: at alpha sqrt(N + kappa) standard deviations of a state of N numbers.

    A range bends over the whole width of a wide prior, so points belong out there. Over Araki's
    four scenes of two cars, 30 seeds each, started with errors of 1 m and 0.5 rad, the mean
    distance RMSE is 0.72 m as here; 0.80 m and 0.81 m with alpha = 0.1 and 0.001; 0.74 m with
    beta = 0; 0.70 m with kappa = 3. From 0.3 m and 0.2 rad all are within 0.01 m of 0.25 m.
    No key may be negative: no covariance can then become so.
    """

    alpha: Positive = 1.0
    """Share of sqrt(N + kappa) standard deviations at which sigma points stand."""
    beta: NotNegative = 2.0
    """Added weight of the middle point in covariances, a pure number; 2 suits a Gaussian."""
    kappa: NotNegative = 0.0
    """Added to N, the number of states, in the distance of sigma points: a pure number."""


class MixtureSettings(Settings):
    """The Gaussian mixture."""

    components: int | None = Field(default=None, ge=1, le=10_000)
    """Hypotheses kept, by default 1000 of up to two poses and 100 of more; four times as many have
    room while they are split."""


class ParticleSettings(Settings):
    """The particle filters."""

    kind: Literal["auto", "sir", "gaussian"] = "auto"
    """Points, or narrow Gaussians with a Kalman filter each; auto: points for up to two poses."""
    particles: int = Field(default=5000, ge=1, le=1_000_000)
    """Points."""
    gaussians: int = Field(default=200, ge=1, le=10_000)
    """Narrow Gaussians."""
    seed: int = Field(default=1, ge=0)
    """Of all that is drawn at random."""


class DistributedSettings(Settings):
    """The distributed particle filter, and the network that its robots share."""

    likelihood: Literal["fit", "shared"] = "fit"
    """What the robots average: functions of their distances, or likelihoods of common particles."""
    particles: int = Field(default=200, ge=1, le=1_000_000)
    """shared: points; fit: the most Gaussians."""
    iterations: int = Field(default=1, ge=0, le=1000)
    """Of the consensus in each round."""
    interval: NotNegative = 0.1
    """Length of a round, s; 0: one for each instant of ranges."""
    graph: str = "complete"
    """Who may hear whom: complete, line, ring, or links as R1-R2,R2-R3."""
    reach: Positive = MAX_SETTING
    """How far a robot is heard, m."""
    loss: float = Field(default=0.0, ge=0.0, lt=1.0)
    """Probability that a neighbour does not hear a message."""
    delay: NotNegative = 0.0
    """Of one message, s."""
    seed: int = Field(default=1, ge=0, lt=2**63)
    """Of all that is drawn at random."""


class FilterSettings(Settings):
    """All keys of `clt localize`."""

    noise: NoiseSettings = NoiseSettings()
    initial: InitialPoseSettings = InitialPoseSettings()
    ukf: UkfSettings = UkfSettings()
    process: Literal["exact", "shi"] = "exact"
    """Form of the process noise: along the heading, or the paper's diagonal."""
    jacobians: Literal["auto", "latest", "first"] = "auto"
    """Taken at the latest estimate, or at the first one of each instant: consistent where the team
    cannot be fixed in the world, or turns about a robot that stands. auto: first with fewer than
    two fixed robots and in body frames. The UKF holds what they hold."""
    gate: NotNegative | None = None
    """A range is rejected when its NIS (a pure number) exceeds this; 0 accepts all. None: the
    Kalman filters weigh outliers by `outliers`, the others reject beyond 16."""
    outliers: OutlierSettings = OutlierSettings()
    reacquire: Positive = 3.0
    """A robot is searched for when more than 40 % of its ranges, with several partners, were
    rejected over this time, s; what is found replaces the estimate where the ranges fit it clearly
    better."""
    received: ReplaySettings = ReplaySettings()
    mixture: MixtureSettings = MixtureSettings()
    pf: ParticleSettings = ParticleSettings()
    dpf: DistributedSettings = DistributedSettings()

    @property
    def nis_gate(self) -> float:
        """The gate, also where none is set."""
        return DEFAULT_GATE if self.gate is None else self.gate
