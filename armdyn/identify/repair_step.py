"""One step of a repair, with its errors on every kind of run."""

from dataclasses import dataclass, field

from armdyn.identify.fit import channel_rmse
from armdyn.identify.search import Step
from armdyn.identify.study import Study


@dataclass(frozen=True)
class RepairStep:
    """One step of a repair.

    Attributes:
        added: names of the effects that came in; empty for the model as given.
        joints: where, for an arm.
        tied_with: effects that these runs cannot tell from the one added.
        rmse: by channel, on the training runs.
        held_out_rmse: by channel, on held-out runs, which take part in choosing; empty where there is a single run.
        chi2_per_sample: 1 when only noise is left.
        bic: with the noise as assumed.
        exam_rmse: by channel, on exam runs, which take part in nothing; empty where none is given.
    """

    added: tuple[str, ...]
    joints: tuple[str, ...]
    tied_with: tuple[str, ...]
    rmse: dict[str, float]
    held_out_rmse: dict[str, float]
    chi2_per_sample: float
    bic: float
    exam_rmse: dict[str, float] = field(default_factory=dict)


def repair_step(study: Study, step: Step) -> RepairStep:
    """One step, with its errors on every kind of run."""
    held_out = study.held_out_blocks(step.fit)
    return RepairStep(
        added=tuple(c.effect for c in step.added),
        joints=tuple(dict.fromkeys(j for c in step.added for j in c.joints)),
        tied_with=tuple(c.effect for c in step.tied),
        rmse=step.fit.rmse(),
        held_out_rmse=channel_rmse(held_out) if held_out is not None else {},
        chi2_per_sample=step.fit.chi2_per_sample,
        bic=step.fit.bic,
        exam_rmse=channel_rmse(study.exam_blocks(step.fit)),
    )
