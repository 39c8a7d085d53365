"""Compare a model with runs: fit its free parameters, measure the error and the noise, find where the model fails."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from armdyn.arm.closed_loop.rollout import SimulatedPositionError
from armdyn.arm.drives import Servo
from armdyn.displayable import Displayable
from armdyn.document import Document, ResultLevel, Section
from armdyn.effects.effect import recorded_columns
from armdyn.identify.bands import PredictionBands, prediction_bands
from armdyn.identify.explained_share import ChannelScale
from armdyn.identify.failed_fit import failed_fit_sentence
from armdyn.identify.fit import Fit, channel_rmse
from armdyn.identify.noise import ljung_box
from armdyn.identify.residual.block import blocks_by_channel, chi2_sum, sample_count
from armdyn.identify.residual.character import probable_cause_text, process_error_share
from armdyn.identify.residual.failing_ranges import FailingRange, find_failing_ranges
from armdyn.identify.residual.force_law import force_law_sentence
from armdyn.identify.residual.missing_force import ForceCurve, compare_missing_forces
from armdyn.identify.residual.noise_tests import ResidualTests
from armdyn.identify.sentence import Verdict
from armdyn.identify.study import Study
from armdyn.identify.tables import (
    channel_table,
    drive_section,
    failing_range_section,
    missing_force_columns,
    motion_section,
    parameter_table,
    prediction_curves,
    sample_columns,
)
from armdyn.identify.uncertainty import uncertainty
from armdyn.identify.unidentified import UnidentifiedCombination, with_quotients
from armdyn.parameter import Parameter
from armdyn.recording.preparation import combined_preparations, preparation_sentence
from armdyn.threads import one_thread

ROUNDING_SHARE_OF_TYPICAL_SIZE = 1e-12
"""Distance from the null value, in typical sizes, up to which an effect that is not fitted is absent."""


@dataclass(frozen=True)
class ChannelQuality:
    """How well one channel is predicted.

    Attributes:
        unit: unit of the errors.
        noise_std: standard deviation of the noise of one sample.
        rmse: root mean square residual of the training runs.
        held_out_rmse: root mean square residual of runs that were not fitted; None where there is a single run.
        chi2_per_sample: squared residual over the noise variance, per sample; 1 where the residual is only noise.
        whiteness_p_value: probability that white noise is at least as correlated as the residual.
        exam_rmse: root mean square residual of exam runs, which are used for nothing else; None where there are none.
    """

    unit: str
    noise_std: float
    rmse: float
    held_out_rmse: float | None
    chi2_per_sample: float
    whiteness_p_value: float
    exam_rmse: float | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Displayable):
    """Result of comparing a model with runs.

    Attributes:
        study: the runs and the model.
        fit: the fit of the model's free parameters, with all residuals.
        parameters: fitted parameters by name, with the run in brackets where a value belongs to one run.
        channels: quality of the prediction, by channel.
        tests: tests of the residual against noise.
        failing_ranges: ranges of time, angle or speed in which the model fails, the worst first.
        process_error: share of the squared residual that behaves like missing dynamics, 0 to 1; None where it cannot be
            estimated.
        intervals_hold: whether the standard deviations can be trusted.
        at_bound: parameters whose fitted value is on a physical bound.
        undetermined: parameters on which the data do not depend.
        left_out: what was not used, such as outliers of the recordings or terms of the model, and where runs leave the
            range of the fitted ones, one sentence each.
        unidentified_combinations: combinations of parameters that these runs do not identify; they have no standard
            deviation.
        std_inflation: factor by which the model's own error widens the standard deviations, for the worst channel; 1
            where the residual is of the size of the noise.
        lost: a sentence on what a failed fit needs, such as start values; empty where the fit has not failed.
        bands: prediction bands; None where the fit has failed.
        rollout: simulated against recorded motion of an arm; empty where the runs do not contain the input of every
            joint's drive.
        drives: drives of an arm, by joint group, with their estimated gains; for an arm whose runs contain commands.
        stated_drives: the same drives as the model's file states them.
    """

    study: Study
    fit: Fit
    parameters: dict[str, Parameter]
    channels: dict[str, ChannelQuality]
    tests: ResidualTests
    failing_ranges: tuple[FailingRange, ...]
    process_error: float | None
    intervals_hold: bool
    at_bound: tuple[str, ...]
    undetermined: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    unidentified_combinations: tuple[UnidentifiedCombination, ...] = ()
    std_inflation: float = 1.0
    lost: str = ""
    bands: PredictionBands | None = None
    rollout: tuple[SimulatedPositionError, ...] = ()
    drives: Mapping[str, Servo] = field(default_factory=dict)
    stated_drives: Mapping[str, Servo] = field(default_factory=dict)

    def document(self) -> Document:
        """Build the tables of parameters, channels and places where the model fails."""
        prepared = preparation_sentence(combined_preparations(run.preparations for run in self.fit.problem.runs))
        model = self.fit.problem.model
        held = [model.background.sentence] if model.background is not None else []
        sections = [
            Section(
                "Parameters",
                " ".join([*self.remarks, *held]),
                tables=[parameter_table(self.parameters), channel_table(self.channels, prepared)],
            ),
            *([drive_section(self.drives, self.stated_drives, self.parameters)] if self.drives else []),
            *([motion_section(self.rollout)] if self.rollout else []),
            *(
                [failing_range_section(self.failing_ranges, self.scale.units)]
                if self.failing_ranges and not self.lost
                else []
            ),
        ]
        return Document(
            "Comparison",
            self.sentence,
            sections,
            ResultLevel.BAD if self.lost else ResultLevel.GOOD if self.explained else ResultLevel.CAUTION,
            data={
                "samples": lambda: sample_columns(self.study, self.fit, self.bands),
                "missing_force": lambda: missing_force_columns(self.missing_force),
                **model.background_table(),
            },
            curves=partial(prediction_curves, self.study, {"predicted": self.fit}, self.bands),
        )

    @property
    def remarks(self) -> list[str]:
        """Sentences for a reader on standard deviations, parameters at a bound, and what was not fitted or not used."""
        if self.lost:
            return [f"{text}." for text in self.left_out]
        found = [self.uncertainty_sentence]
        # A drive's delay is an unknown of the fit, and no parameter of the model.
        ends = {c.name: (v, c.parameter.unit) for c, v in zip(self.fit.problem.columns, self.fit.values, strict=True)}
        for name in self.at_bound:
            value, unit = ends[name]
            found.append(
                f"{name} ended on its physical bound, {value:.4g} {unit}: it may stand in for a missing effect."
                if value
                else f"{name} ended at 0, its least possible value: these runs show none."
            )
        found += [f"{one.sentence}." for one in self.unidentified_combinations]
        for name in self.undetermined:
            kept = self.parameters.get(name)
            holds = "" if kept is None else f", and values that depend on it hold for {kept.value:.4g} {kept.unit}"
            found.append(f"{name} was not fitted: these runs say nothing about it{holds}.")
        return [*found, *(f"{text}." for text in self.left_out)]

    @cached_property
    def missing_force(self) -> tuple[ForceCurve, ...]:
        """The force that the model lacks, against what it may depend on; empty where the fit has failed."""
        return () if self.lost else compare_missing_forces(self.fit)

    @property
    def explained(self) -> bool:
        """Whether the residual of the comparison is only noise."""
        return self.verdict is Verdict.EXPLAINED

    @property
    def verdict(self) -> Verdict:
        """Verdict on the compared model: explained, not explained, or the fit has failed."""
        return Verdict.LOST if self.lost else Verdict.NOT_EXPLAINED if self.tests.fails else Verdict.EXPLAINED

    @property
    def scale(self) -> ChannelScale:
        """Units and noise of the compared channels."""
        return ChannelScale.of(self.fit.blocks)

    @property
    def uncertainty_sentence(self) -> str:
        """A sentence on how far the standard deviations can be trusted."""
        if self.intervals_hold:
            return "The remaining error is white noise: intervals of a value ± 2 std hold."
        if self.std_inflation > 1.0:
            return (
                "The model's own error is larger than the noise. The standard deviations count it in, as large and as "
                f"correlated as the residual (up to {self.std_inflation:.2g} times the noise's); what is missing may "
                "still shift a value further."
            )
        what = "The remaining error is not white noise: "
        if self.explained:
            what = "The remaining error is as small as the noise, but neighbouring samples have similar errors: "
        if self.fit.weighted is not None:
            return f"{what}the standard deviations are enlarged for its size and correlation."
        return f"{what}the true uncertainty may be larger than the standard deviations."

    @property
    def sentence(self) -> str:
        """The result in one or two sentences, for a reader."""
        chi2 = self.fit.chi2_per_sample
        if self.lost:
            return self.lost
        if self.explained:
            return f"The model explains these runs: χ² per sample {chi2:.2f}, what is left is noise."
        text = f"{force_law_sentence(self.missing_force)}Something is left to explain: χ² per sample {chi2:.3g}"
        if self.failing_ranges:
            text += f"; worst {self.failing_ranges[0].sentence}"
        if self.process_error is not None:
            text += f"; {probable_cause_text(self.process_error)}"
        return text + "."


@one_thread
def compare(study: Study) -> Comparison:
    """Fit the model of a study as it is, without added effects, and test the residual."""
    fit = study.first()
    return comparison(study, fit, study.tests(fit, study.present))


def comparison(
    study: Study, fit: Fit, left: ResidualTests, *, process_error: bool = True, unnamed: Collection[str] = ()
) -> Comparison:
    """Build the comparison of a fitted model with the runs of a study.

    Args:
        study: the runs and the model.
        fit: the fit.
        left: tests of the fit's residual against noise.
        process_error: whether to test if the residual behaves like missing dynamics, which is slow.
        unnamed: parameters of a background, which are not listed.
    """
    channels, certain, together = channel_qualities(study, fit), uncertainty(study, fit), study.unidentified(fit)
    mixed = {name for one in together for name in one.unidentified_parameters}
    ends = set(fit.at_bound) - set(unnamed)
    needed = failed_fit_sentence(fit) if study.fit_has_failed(fit) else ""
    bands = None if needed else prediction_bands(study, fit, certain.covariance_with_exact_gains)
    white = all(c.whiteness_p_value > study.settings.search.chance_level / len(channels) for c in channels.values())
    return Comparison(
        study=study,
        fit=fit,
        parameters={n: p for n, p in fitted_parameters(study, fit).items() if n not in unnamed},
        channels=channels,
        tests=left,
        failing_ranges=find_failing_ranges(fit),
        process_error=process_error_share(fit) if process_error and left.fails else None,
        intervals_hold=not (left.fails or needed) and white,
        at_bound=tuple(sorted(ends)),
        undetermined=tuple(
            c.name
            for c, wanted, free in zip(study.problem.columns, study.problem.fitted, fit.free, strict=True)
            if wanted and not free and c.parameter.name not in mixed
        ),
        left_out=(
            *(f"{run.name}: {text}" for run in (*study.runs, *study.held_out) for text in run.warnings),
            *(
                f"{run.name}: no '{column.name}': taken to be {column.usual:g} {column.unit}, its usual value"
                for column in recorded_columns(study.model.effects)
                for run in (*study.runs, *study.held_out)
                if column.name not in run.extra
            ),
            *study.remarks(fit),
            *certain.open_questions,
            *(one.sentence for one in (bands.extrapolations if bands else ())),
        ),
        unidentified_combinations=tuple(with_quotients(one, fit, certain.covariance) for one in together),
        std_inflation=certain.std_inflation,
        lost=needed,
        bands=bands,
    )


def channel_qualities(study: Study, fit: Fit) -> dict[str, ChannelQuality]:
    """Compute how well a fit predicts every channel."""
    held_out_rmse = channel_rmse(study.held_out_blocks(fit))
    exam_rmse = channel_rmse(study.exam_blocks(fit))
    rmse, scale = fit.rmse(), ChannelScale.of(fit.blocks)
    return {
        channel: ChannelQuality(
            unit=scale.units[channel],
            noise_std=scale.noise[channel],
            rmse=rmse[channel],
            held_out_rmse=held_out_rmse.get(channel),
            chi2_per_sample=chi2_sum(blocks) / sample_count(blocks),
            whiteness_p_value=min(ljung_box(block.residual) for block in blocks),
            exam_rmse=exam_rmse.get(channel),
        )
        for channel, blocks in blocks_by_channel(fit.blocks).items()
    }


def fitted_parameters(study: Study, fit: Fit) -> dict[str, Parameter]:
    """Fitted parameters of a study's model by name, without absent effects and a background.

    Values that these runs do not identify have no standard deviation. The other standard deviations include the
    correlation of the noise and, where it is larger than the noise, the model's own error; see `uncertainty`.
    """
    covariance = uncertainty(study, fit).covariance
    with np.errstate(divide="ignore"):
        prior = np.where(study.problem.is_effect & (fit.weighted is not None), 1.0 / fit.minimised.prior_weight, np.inf)
    only_prior = np.sqrt(np.diag(covariance)) > study.settings.verdict.determined_share * prior
    mixed = {name for one in study.unidentified(fit) for name in one.unidentified_parameters}
    present = {name for c in study.candidates for name in c.names}
    held = study.model.background.names if study.model.background is not None else ()
    result = {}
    for i, column in enumerate(study.problem.columns):
        gone = abs(fit.values[i] - study.problem.null[i]) <= ROUNDING_SHARE_OF_TYPICAL_SIZE * study.problem.typical[i]
        absent = column.parameter.name in present and not fit.free[i] and gone
        if absent or column.parameter.name in held:
            continue
        told = (fit.free[i] or fit.consider_parameters[i]) and np.isfinite(covariance[i, i])
        told = told and column.parameter.name not in mixed and not only_prior[i]
        std = float(np.sqrt(covariance[i, i])) if told else None
        result[column.name] = replace(column.parameter, value=float(fit.values[i]), std=std, fitted=bool(fit.free[i]))
    return result
