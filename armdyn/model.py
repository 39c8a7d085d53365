"""The base class of all models, which predict recordings from base physics, effects and parameters."""

from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np

from armdyn.displayable import Displayable
from armdyn.document import Column, Document, Section, Table, attribute_columns
from armdyn.effect_model import EffectModel
from armdyn.effects.effect import Effect
from armdyn.run import Channel, Run

if TYPE_CHECKING:
    from armdyn.arm.links import LinkInertiaChange
    from urdf import Robot

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class AssumedGain:
    """A gain that readings share and that no fit changes: it is assumed to be 1, within a tolerance.

    Attributes:
        channels: names of the channels whose readings have it in common.
        std: its relative standard deviation.
        relative: names of parameters that it does not change: gains of single channels, relative to it, and offsets.
        question: sentence, without full stop, on what would tell it, for runs that do not; empty where none is said.
    """

    channels: tuple[str, ...]
    std: float
    relative: tuple[str, ...] = ()
    question: str = ""


@dataclass(frozen=True)
class Prediction:
    """Prediction of a model for one run; the samples of all channels are in one array, channel after channel.

    Attributes:
        channels: names of the channels in the order of the blocks.
        slices: slice of each channel's samples in the arrays, by channel name.
        time: (n,) times of the samples, s.
        values: (n,) predicted values, in the channels' units.
        sensitivities: (n, p) exact derivatives with respect to the parameters, in the order of `Model.names`.
        moving: (k,) indices of the parameters on which a channel can depend, by channel; all where it is not listed.
    """

    channels: tuple[str, ...]
    slices: Mapping[str, slice]
    time: np.ndarray
    values: np.ndarray
    sensitivities: np.ndarray
    moving: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def values_by_channel(self) -> dict[str, np.ndarray]:
        """(n,) predicted values by channel."""
        return {name: self.values[rows] for name, rows in self.slices.items()}


def prediction_from_channels(parts: Sequence[tuple[str, np.ndarray, np.ndarray, np.ndarray]]) -> Prediction:
    """Join channels to a prediction; each is given as its name, times (n,) s, values (n,) and sensitivities (n, p)."""
    names, times, values, sensitivities = zip(*parts, strict=True)
    ends = np.cumsum([len(time) for time in times]).tolist()
    slices = {name: slice(end - len(time), end) for name, time, end in zip(names, times, ends, strict=True)}
    time, value, derivatives = (np.concatenate(blocks) for blocks in (times, values, sensitivities))
    return Prediction(names, slices, time, value, derivatives)


@dataclass(frozen=True, repr=False)
class Model(EffectModel, Displayable):
    """Base class of `PendulumModel`, `ArmModel` and `PhysicsModel`: effects and parameters that predict recordings."""

    linear = False
    """Whether predictions are linear in most parameters, so that one linearisation predicts the influence of any set of
    effects."""
    values_are_cheap = False
    """Whether `predict_values` takes much less time than `predict`."""

    @property
    def step(self) -> float:
        """Approximate step of a simulation, s; it limits the length of a recording that can be simulated."""
        return 0.005

    @property
    def min_seconds_to_identify_effect(self) -> float:
        """Shortest part of a run, s, in which effects such as friction and creep are identifiable."""
        return 3.0

    def __str__(self) -> str:
        """The base model, its values and its effects, in one line."""
        said = [effect.label for effect in self.named_effects] or ["no effects"]
        said += [self.background.label] if self.background is not None else []
        return f"{self.base_summary}; {', '.join(said)}"

    __repr__ = __str__

    @property
    def base_summary(self) -> str:
        """The base model and its parameter values in one line, without effects and without constants such as gravity.

        A constant is left out while it has its usual value.
        """
        shared = (p for p in self.parameters.values() if p.scope == "shared" and not p.effect)
        own = (p for p in shared if not p.is_consider_parameter or p.value != p.null)
        values = ", ".join(f"{p.name} {p.value:.4g} {p.unit}" for p in own)
        return f"{self.base}, {values}" if values else self.base

    def document(self) -> Document:
        """Build a document with the table of the model's parameters."""
        shared = {name: p for name, p in self.without_background().parameters.items() if p.scope == "shared"}
        values = shared.values()
        columns = [Column("parameter", list(shared)), *attribute_columns(values, value=".6g")]
        columns += [Column("std", [p.std for p in values], ".2g"), *attribute_columns(values, unit="", fitted="")]
        tables = [Table(columns, name="parameters")]
        said = self.background.sentence if self.background is not None else ""
        sections = [Section("Parameters", said, tables=tables)]
        return Document(f"Model: {self.base}", f"{self}.", sections, data=self.background_table())

    def guess_start_state(self, run: Run) -> Mapping[str, float]:
        """First guesses, by name, of parameters with one value per run, such as the angle at the start of a swing."""
        del run
        return {}

    def possible_start_states(self, run: Run, theta: np.ndarray) -> Sequence[Mapping[str, float]]:
        """Start states (values by parameter name) from each of which a fit is tried; empty where one start suffices.

        Args:
            run: a recording.
            theta: (p,) parameter values.
        """
        del run, theta
        return ()

    def start_state_window_seconds(self, theta: np.ndarray) -> float:
        """Length of the first part of a run, s, that suffices to choose among `possible_start_states`.

        Args:
            theta: (p,) parameter values.
        """
        del theta
        return np.inf

    def split_at_gaps(self, run: Run) -> tuple[Run, ...]:
        """Split a run where samples are missing; the run stays whole where the model can simulate through a gap."""
        return (run,)

    def split_into_pieces(self, run: Run) -> Sequence[Run]:
        """Split a run into the parts that are simulated separately, each from a start state; by default one part."""
        return (run,)

    def changes_link(self, names: Sequence[str]) -> bool:
        """Whether the parameters `names`, of one effect on one joint, change a link's mass, centre or inertia."""
        del names
        return False

    def link_inertia_changes(
        self, theta: np.ndarray, covariance: np.ndarray, of_runs_alone: np.ndarray, free: np.ndarray
    ) -> tuple["LinkInertiaChange", ...]:
        """Links whose mass, centre or inertia the effects change, in the order of the joints; empty without links.

        Args:
            theta: (p,) fitted parameter values.
            covariance: (p, p) covariance of the parameters.
            of_runs_alone: (p, p) covariance from the runs almost alone, with priors that are a hundred times wider.
            free: (p,) bool, parameters that were fitted.
        """
        del theta, covariance, of_runs_alone, free
        return ()

    def capability(self, kind: type[Kind]) -> Kind | None:
        """This model as one of some kind, such as an `ArmModel` with joints, links and drives; None if it is none."""
        return self if isinstance(self, kind) else None

    def file_entries(self, folder: Path) -> Mapping[str, Any]:
        """Entries of a model file that define the base model; paths in them are relative to `folder`."""
        del folder
        return {"base": self.base}

    @property
    def has_catalogue_stages(self) -> bool:
        """Whether the stages are those of the catalogue's effects; a user's own base may define its ``"load"`` anew."""
        return True

    @property
    def own_effects(self) -> tuple[Effect, ...]:
        """Effects that a user's own base defines, in addition to those of the catalogue."""
        return ()

    @property
    def robot(self) -> "Robot | None":
        """Robot whose joints the model describes; None for a model of anything else."""
        return None

    @property
    def guessed_parameters(self) -> tuple[str, ...]:
        """Names of parameters whose given values are only guesses; those that no run identifies stay near them."""
        return ()

    def adapted_to(self, runs: Sequence[Run]) -> Self:
        """A copy of the model adapted to what the runs contain, such as a servo's commands; by default no change."""
        del runs
        return self

    def with_model_channels(self, run: Run) -> Run:
        """A copy of a run in which the further quantities that the model predicts or needs as input are channels."""
        return run

    def without_predictions(self, run: Run, names: Collection[str]) -> Run:
        """A copy of a run whose measured channels of some names are not compared with the model."""
        return replace(run, channels={name: c for name, c in run.channels.items() if name not in names})

    @property
    def hangs_from_gripper(self) -> bool:
        """Whether the model is a load on a string, so that an experiment can be designed as a gripper motion."""
        return False

    @property
    def open_questions(self) -> tuple[str, ...]:
        """What the recordings leave unknown about the model, and what would answer it: sentences without full stops."""
        return ()

    def assumed_gains(self, freed: Collection[str]) -> Sequence[AssumedGain]:
        """Gains of sensors that no fit changes, and whose uncertainty counts; by default all sensors are exact.

        Args:
            freed: names of the parameters that are fitted.
        """
        del freed
        return ()

    @property
    def excluded_effects(self) -> frozenset[str]:
        """Names of effects that a diagnosis does not consider; a user can still add them.

        The recordings state their values, or they would fit any recording.
        """
        return frozenset()

    def can_show(self, effect: Effect, channels: Collection[str]) -> bool:
        """Whether predictions of recordings of these channels can depend on an effect."""
        return effect.is_visible_in(channels)

    def with_estimated_channels(self, run: Run) -> Run:
        """A copy of a run with estimated channels, such as a joint torque from the position error of its servo."""
        return run

    def reduced_model(self, needed: Collection[str], runs: Sequence[Run]) -> Self:
        """A model with the `needed` effects that predicts `runs` faster; it may lack any other effect.

        While the effects that it lacks are at their null values, both models predict the same. The order of the
        parameters does not change.
        """
        del runs
        return self.with_only_effects(needed)

    def prepare_run(self, run: Run, beside: Sequence[Run] = ()) -> Run:
        """Prepare a run for comparison with this model; do this once per run, before its noise is estimated.

        An arm's model low-passes the measured torques and keeps fewer samples of them; its predictions for the returned
        run are processed in the same way. Other models use runs as they are.

        Args:
            run: a recording.
            beside: further recordings that show the properties of the same sensors; by default none.

        Raises:
            InputError: the run cannot be compared with this model.
        """
        del beside
        return run

    def jump_times(self, run: Run) -> np.ndarray:
        """(j,) times, s, ascending, at which the prediction for a prepared run may jump."""
        del run
        return np.zeros(0)

    def noise(self, run: Run, theta: np.ndarray) -> Mapping[str, float]:
        """Standard deviation of the noise of a prepared run, for the channels where it depends on the parameters.

        Through an arm's inertias, the noise of its measured positions becomes noise of its predicted torques.

        Args:
            run: a prepared run.
            theta: (p,) parameter values.
        """
        del run, theta
        return {}

    def covariates(self, run: Run, theta: np.ndarray) -> Mapping[str, Channel]:
        """Signals on which the residual of a run may depend, by name, such as the swing angle or a joint's speed."""
        del run, theta
        return {}

    def force_channels(self, run: Run) -> Mapping[str, str]:
        """Channels whose residual is itself a missing force or torque, with the joint of each.

        Empty for a model that simulates a motion: its residual shows a missing force only through the motion.
        """
        del run
        return {}

    @abstractmethod
    def predicted_channels(self, run: Run) -> tuple[str, ...]:
        """Channels of a run that this model predicts, in the order of the prediction.

        Raises:
            InputError: the run has no channel that this model predicts.
        """

    @abstractmethod
    def predict(self, run: Run, theta: np.ndarray) -> Prediction:
        """Predict the channels of a run, with derivatives with respect to the parameters.

        Args:
            run: a recording; only the channels that it contains are predicted.
            theta: (p,) parameter values for this run, in the order of `names`.

        Raises:
            InputError: the run has no channel that this model predicts.
        """

    def predict_values(self, run: Run, theta: np.ndarray) -> Mapping[str, np.ndarray]:
        """(n,) predicted values by channel, up to rounding those of `predict`."""
        return self.predict(run, theta).values_by_channel
