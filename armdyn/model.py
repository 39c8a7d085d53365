"""A model: a base, effects and parameters. It is never changed in place."""

from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from armdyn.document import Column, Document, Section, Table, columns_of
from armdyn.effect_model import EffectModel
from armdyn.effects.effect import Effect
from armdyn.run import Channel, Run
from armdyn.shown import Displayable

if TYPE_CHECKING:
    from armdyn.arm.links import LinkChange
    from armdyn.arm.model import ArmModel
    from armdyn.arm.rollout import RollOut
    from urdf import Robot


@dataclass(frozen=True)
class Prediction:
    """Prediction of a model for one run, with all channels one after another.

    Attributes:
        channels: names of the channels in the order of the blocks.
        slices: slice of each channel's samples.
        time: (n,) times of the samples, s.
        values: (n,) predicted values, in the channels' units.
        sensitivities: (n, p) exact derivatives with respect to the parameters, in the order of `Model.names`.
    """

    channels: tuple[str, ...]
    slices: Mapping[str, slice]
    time: np.ndarray
    values: np.ndarray
    sensitivities: np.ndarray


def join_channels(parts: Sequence[tuple[str, np.ndarray, np.ndarray, np.ndarray]]) -> Prediction:
    """Join channels, each with its name, times (n,) s, values (n,) and sensitivities (n, p), to a prediction."""
    names, times, values, sensitivities = zip(*parts, strict=True)
    ends = np.cumsum([len(time) for time in times]).tolist()
    slices = {name: slice(end - len(time), end) for name, time, end in zip(names, times, ends, strict=True)}
    return Prediction(names, slices, *(np.concatenate(blocks) for blocks in (times, values, sensitivities)))


@dataclass(frozen=True, repr=False)
class Model(EffectModel, Displayable):
    """Base class of `PendulumModel`, `ArmModel` and `PhysicsModel`: effects and parameters that predict recordings."""

    linear = False
    """Whether predictions are linear in most unknowns; one expansion then predicts the influence of any set of
    effects."""

    @property
    def step(self) -> float:
        """Approximate step of a simulation, s; it limits the length of a recording that can be simulated."""
        return 0.005

    @property
    def settled_window(self) -> float:
        """Length of a part of a run, s, below which friction and creep are not identifiable."""
        return 3.0

    def __str__(self) -> str:
        """The base, its values and its effects, in one line."""
        said = [effect.label for effect in self.named_effects] or ["no effects"]
        said += [self.background.label] if self.background is not None else []
        return f"{self.about}; {', '.join(said)}"

    __repr__ = __str__

    @property
    def about(self) -> str:
        """The base with its values, without usual values that no fit changes and without effects."""
        shared = (p for p in self.parameters.values() if p.scope == "shared" and not p.effect)
        own = (p for p in shared if not p.considered or p.value != p.null)
        values = ", ".join(f"{p.name} {p.value:.4g} {p.unit}" for p in own)
        return f"{self.base}, {values}" if values else self.base

    def document(self) -> Document:
        """Build the table of parameters."""
        shared = {name: p for name, p in self.named_only().parameters.items() if p.scope == "shared"}
        values = shared.values()
        columns = [Column("parameter", list(shared)), *columns_of(values, value=".6g")]
        columns += [Column("std", [p.std for p in values], ".2g"), *columns_of(values, unit="", fitted="")]
        tables = [Table(columns, name="parameters")]
        said = self.background.sentence if self.background is not None else ""
        sections = [Section("Parameters", said, tables=tables)]
        return Document(f"Model: {self.base}", f"{self}.", sections, data=self.background_data())

    def guess_start(self, run: Run) -> Mapping[str, float]:
        """First guesses of the parameters with one value per run: the state at the start of a simulated motion."""
        del run
        return {}

    def possible_starts(self, run: Run, theta: np.ndarray) -> Sequence[Mapping[str, float]]:
        """Start states from each of which a fit is tried; empty where a fit converges from any start.

        Args:
            run: a recording.
            theta: (p,) parameter values.
        """
        del run, theta
        return ()

    def start_window(self, theta: np.ndarray) -> float:
        """Length of a run, s, that suffices to choose among the possible starts; `theta` is (p,)."""
        del theta
        return np.inf

    def between_gaps(self, run: Run) -> tuple[Run, ...]:
        """The parts of a run between missing samples; the whole run, where a simulation goes on through a gap."""
        return (run,)

    def pieces(self, run: Run) -> Sequence[Run]:
        """The run, or its parts with a start state each."""
        return (run,)

    def changes_link(self, names: Sequence[str]) -> bool:
        """Whether the parameters `names`, of one effect on one joint, change a link's mass, centre or inertia."""
        del names
        return False

    def link_changes(
        self, theta: np.ndarray, covariance: np.ndarray, of_runs_alone: np.ndarray, free: np.ndarray
    ) -> tuple["LinkChange", ...]:
        """Links that effects change, in the order of the joints; empty for a model without links.

        Args:
            theta: (p,) fitted parameters.
            covariance: (p, p) covariance of the parameters.
            of_runs_alone: (p, p) covariance nearly without priors.
            free: (p,) bool, fitted parameters.
        """
        del theta, covariance, of_runs_alone, free
        return ()

    def as_arm(self) -> "ArmModel | None":
        """This model if it is of an arm, with joints, links and drives; None for every other base."""
        return None

    def described(self, folder: Path) -> Mapping[str, Any]:
        """Entries of a model file that name the base; paths in them are relative to the file's `folder`."""
        del folder
        return {"base": self.base}

    @property
    def has_catalogue_stages(self) -> bool:
        """Whether its stages are those of the catalogue's effects; a user's own base may define another load."""
        return True

    @property
    def own_effects(self) -> tuple[Effect, ...]:
        """Effects that come with the base, besides the catalogue's."""
        return ()

    @property
    def robot(self) -> "Robot | None":
        """Robot whose joints the model describes; None for a model of anything else."""
        return None

    def motion_errors(self, recordings: "Sequence[tuple[Run, str]]") -> "tuple[RollOut, ...]":
        """Simulated against recorded motion in recordings, each with its role; empty for a model without joints."""
        del recordings
        return ()

    @property
    def first_guesses(self) -> tuple[str, ...]:
        """Parameters whose values are only guesses; unidentified ones stay near the given values."""
        return ()

    def following(self, runs: Sequence[Run]) -> Self:
        """The model adapted to further quantities of recordings, such as a servo's commands; most are unchanged."""
        del runs
        return self

    def taking(self, run: Run) -> Run:
        """The run with those of its further quantities as channels that the model predicts or needs as input."""
        return run

    @property
    def hangs_from_gripper(self) -> bool:
        """Whether it is a load on a string, for which motions of the gripper can be designed."""
        return False

    @property
    def open_questions(self) -> tuple[str, ...]:
        """Open questions that recordings leave, with what would answer them: sentences without full stops."""
        return ()

    @property
    def told_beside(self) -> frozenset[str]:
        """Names of effects that are no candidates, because recordings state them or because they fit any recording.

        A user can still add them.
        """
        return frozenset()

    def reading(self, run: Run) -> Run:
        """The run with estimated channels that the model predicts: a servo's position error gives its torque."""
        return run

    def holding(self, needed: Collection[str], runs: Sequence[Run]) -> Self:
        """A model that may lack effects which are not `needed`, where it predicts `runs` faster.

        At the null values of the effects that it lacks, it predicts the same; its parameters keep their order.
        """
        del runs
        return self.with_only(needed)

    def prepared(self, run: Run, beside: Sequence[Run] = ()) -> Run:
        """The run in the form for comparison with this model; prepare every run once, before its noise is estimated.

        For an arm the measured torques are low-passed and thinned out here, and the predictions for the returned run
        likewise. Other models use runs as they are.

        Args:
            run: a recording.
            beside: further recordings that show the properties of the sensors; by default this one alone.

        Raises:
            InputError: the run cannot be compared with this model.
        """
        del beside
        return run

    def jumps(self, run: Run) -> np.ndarray:
        """(j,) times, s, ascending, at which the prediction for a prepared run may jump."""
        del run
        return np.zeros(0)

    def noise(self, run: Run, theta: np.ndarray) -> Mapping[str, float]:
        """Standard deviation of the compared samples, by channel of a prepared run, where it depends on (p,) `theta`.

        The noise of an arm's positions becomes torque through its inertias.
        """
        del run, theta
        return {}

    def covariates(self, run: Run, theta: np.ndarray) -> Mapping[str, Channel]:
        """Signals on which a residual may depend, such as the swing angle or a joint's speed, over the run's time."""
        del run, theta
        return {}

    def force_channels(self, run: Run) -> Mapping[str, str]:
        """Channels whose residual is a missing force, by name with the joint; empty for a model with states.

        A model with states lacks an acceleration, which its residual contains only through the motion.
        """
        del run
        return {}

    @abstractmethod
    def predicted_channels(self, run: Run) -> tuple[str, ...]:
        """Channels of a run that this model predicts, in the order of the prediction.

        Raises:
            InputError: there is no such channel.
        """

    @abstractmethod
    def predict(self, run: Run, theta: np.ndarray) -> Prediction:
        """Predict the channels of a run.

        Args:
            run: a recording; the channels that both it and the model have are predicted.
            theta: (p,) parameter values for this run, in the order of `names`.

        Raises:
            InputError: the run has no channel that this model predicts.
        """
