"""The numbers that decide an answer, each with the calibration that chose it; all others are accuracies or widths."""

from dataclasses import dataclass, field
from math import erfc, exp, log, sqrt


@dataclass(frozen=True)
class SearchSettings:
    """What an effect must show before it is named.

    Attributes:
        acceptance_nats: evidence beyond chance, nats, at which an effect is accepted, or anything else that is chosen
            among alternatives: one false effect in a hundred clean recordings.
        further_joint_nats: evidence beyond chance, nats, at which an accepted effect is accepted on a further joint.
        tie_nats: difference of score, nats, below which runs cannot tell two sets apart: above it the better set was
            right in 320 of 320 cases.
        value_stds: least size of the values of a named effect, in their standard deviations.
        linear_typical_sizes: size of an effect of the whole arm, such as a tilt of its base (0.3 rad), in typical
            sizes, beyond which the model is linearised again there.
        background_widths: prior widths, in typical sizes, that are tried for the small values of a background.
        link_width: prior width of what a link differs by from its description, in typical sizes: 9 % of mass, centre
            and extent. A servo shows a link's weight by how far it sags, so that a link which is described wrongly
            looks like springs and frictions.
        leading_share: share of the squared error of the model as given that an effect on one joint removes, from which
            on it is reported before the others.
        explained_share_per_parameter: share of the squared error above the noise that each parameter of an effect of a
            model with states must explain: parameters that the public recordings of pendulums need explain 0.17 or
            more, a lag that errors of the simulated robot imitate 0.10.
        missing_evidence_share: share of an effect's evidence that a rival may lack and still be optimised and compared
            by its residual: linearised at the optimum of a sensor's lag of 12 ms, a lag of the gripper lacks 19 of the
            414 nats that it has at its own optimum.
        pair_residual_ratio: ratio of the residual of a pair of effects to that of the set with the best evidence
            (squared errors above the noise) up to which the pair replaces the set, while errors are not gross: a wrong
            pair had 0.41 with small errors of an encoder, right pairs with less evidence had 0.18 or less.
        compared_excess: squared error above the noise, over the noise variance, from which on sets are compared by
            simulations of whole runs.
        held_out_error_increase: relative increase of the error on held-out runs up to which an effect is kept.
    """

    acceptance_nats: float = log(100.0)
    further_joint_nats: float = log(10.0)
    tie_nats: float = 3.0
    value_stds: float = 2.0
    linear_typical_sizes: float = 3.0
    background_widths: tuple[float, ...] = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
    link_width: float = 0.3
    leading_share: float = 0.05
    explained_share_per_parameter: float = 0.125
    missing_evidence_share: float = 0.5
    pair_residual_ratio: float = 0.25
    compared_excess: float = 1.0
    held_out_error_increase: float = 0.02

    @property
    def chance_level(self) -> float:
        """Probability by chance at which something is accepted: that of `acceptance_nats`."""
        return exp(-self.acceptance_nats)

    @property
    def zero_probability(self) -> float:
        """Probability by chance above which values count as zero: that of `value_stds` for one value."""
        return erfc(self.value_stds / sqrt(2.0))

    @property
    def background_nats(self) -> float:
        """Gain of log likelihood, nats, that a background needs, because its width is chosen among several."""
        return self.acceptance_nats + log(len(self.background_widths))

    def needed_share(self, parameters: float) -> float:
        """Share of the squared error that may be left where so many parameters were added to a model with states."""
        return (1.0 - self.explained_share_per_parameter) ** parameters


@dataclass(frozen=True)
class NoiseSettings:
    """What counts as noise, and how much independent information an error is.

    Attributes:
        model_errors: number of independent samples of a model's own error in one channel, however long a recording is.
            With 8 the springs of a Gen3 arm are not found; with 20 the error on exam runs is below that of the best
            single prior width for 10 of 15 imperfect arms, and at most 1.13 times it for the others.
        servo_error_seconds: length of a stretch of a servo's motion, s, whose errors are independent of the next one's.
            With 5 s the load friction and the rotor of an XL330 are not found; the correlation time of the residuals is
            minutes where a joint follows a slow wave.
        variance_ratio: ratio of a residual's variance to the noise variance up to which it counts as noise: for clean
            simulations with many samples it is up to 1.1.
        stated_chi2: chi2 per sample, for the stated noise, beyond which the model's own error is larger than the noise.
        least_stated_chi2: chi2 per sample, for the stated noise, up to which an excess does not count however sure it
            is; not calibrated.
        estimated_chi2: the same as `stated_chi2` for an estimated noise: third differences underestimate noise with a
            correlation of 0.8 from one sample to the next by a factor of 7.5.
        minimum_chi2: chi2 per sample up to which a fit is in the right minimum: a swing in the wrong phase leaves more.
        gross_chi2: chi2 per sample above which an error is gross: derivatives then do not lead to a distant minimum.
        excess_stds: least excess of a mean squared residual over that of noise that is used in comparisons, in standard
            deviations of the latter.
        chance_excess_stds: largest such excess that may be noise alone.
        z: largest z value of the residual's chi2 that counts as noise.
        whiteness: least p-value of the whiteness test that is noise: with `z`, 0 false alarms in 360 clean runs.
        effect_probability: smallest probability by chance of the best effect that counts as noise. Effects resemble one
            another, so the rate of false alarms is half as large.
        repeated_share: largest share of a joint's squared error, for the model as given, that may repeat itself in what
            a model leaves, and is said but does not count as a missing effect.
        kick_ratio: size of the kicks, relative to the accuracy with which one piece of the motion determines a speed,
            above which a motion that was derived from a force may be wrong.
    """

    model_errors: float = 20.0
    servo_error_seconds: float = 1.0
    variance_ratio: float = 1.2
    stated_chi2: float = 2.0
    least_stated_chi2: float = 1.1
    estimated_chi2: float = 10.0
    minimum_chi2: float = 1.5
    gross_chi2: float = 20.0
    excess_stds: float = 0.5
    chance_excess_stds: float = 3.0
    z: float = 5.0
    whiteness: float = 1e-4
    effect_probability: float = 5e-3
    repeated_share: float = 0.01
    kick_ratio: float = 10.0

    def max_variance_ratio(self, samples: float) -> float:
        """Ratio of variances up to which a residual counts as noise.

        Args:
            samples: number of independent samples; by chance the ratio varies about one with a standard deviation of
                sqrt(2 / samples).
        """
        return self.variance_ratio * (1.0 + sqrt(2.0 / max(samples, 1.0)))


@dataclass(frozen=True)
class VerdictSettings:
    """How an answer is worded.

    Attributes:
        explained_at_noise: share of the squared error that the catalogue must explain where the residual is of the size
            of the noise. Effects of the catalogue are idealised and may be wrong by a sixth of their size; if more
            remains, the missing effect is another one, which the nearest effect of the catalogue imitates.
        explained_above_noise: the same where the model's own error is far above the noise, as with every real robot:
            effects outside the catalogue leave half of the squared error or more, real robots at most a tenth.
        first_effect_share: share that the first effect must explain; otherwise the missing effect counts as unknown.
        lost_share: share of the signal's own variance that a fit leaves, above which it is lost: what leaves as much as
            it explains says nothing, though a start far off makes it look like 99.9 % explained.
        term_probability: probability by chance up to which a term or a frequency of a residual is reported.
        range_stds: number of standard deviations by which the chi2 of a reported range exceeds that of noise.
        range_ratio: ratio of the chi2 per sample of a reported range to that of its channel.
        determined_share: largest standard deviation, as a share of its prior's, of a value that counts as determined.
    """

    explained_at_noise: float = 0.97
    explained_above_noise: float = 0.8
    first_effect_share: float = 0.5
    lost_share: float = 0.5
    term_probability: float = 1e-3
    range_stds: float = 5.0
    range_ratio: float = 1.5
    determined_share: float = 0.5


@dataclass(frozen=True)
class Settings:
    """All numbers that decide the answer of a study: what is accepted, what is noise, how the answer is worded."""

    search: SearchSettings = field(default_factory=SearchSettings)
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    verdict: VerdictSettings = field(default_factory=VerdictSettings)


DEFAULT_SETTINGS = Settings()
"""The settings of every study that states no others."""
