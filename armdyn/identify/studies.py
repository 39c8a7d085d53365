"""The study that suits a model."""

from collections.abc import Collection, Sequence

from armdyn.effects.effect import Effect
from armdyn.identify.linear_study import LinearStudy
from armdyn.identify.settings import DEFAULT_SETTINGS, Settings
from armdyn.identify.state_space.study import StateSpaceStudy
from armdyn.identify.study import Study
from armdyn.model import Model
from armdyn.run import Run


def make_study(
    model: Model,
    runs: Sequence[Run],
    held_out: Sequence[Run],
    catalogue: Sequence[Effect],
    exam: Sequence[Run] = (),
    asked: Collection[str] = (),
    catalogue_size: int = 0,
    settings: Settings = DEFAULT_SETTINGS,
) -> Study:
    """Make the study that suits a model: a `LinearStudy` or a `StateSpaceStudy`; see `Study` for the arguments."""
    kind = LinearStudy if model.linear else StateSpaceStudy
    return kind(model, runs, held_out, catalogue, exam, asked, catalogue_size, settings)
