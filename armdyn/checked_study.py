"""Compare, diagnose, repair and extend a model with recordings that are inspected for mistakes first.

A mistake in a recording, such as torques with the wrong sign, looks like a missing effect. So the recordings are
inspected before an effect is named or a value is reported, and impossible fitted values are refused.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from armdyn.arm.closed_loop.motion_model import MotionModel
from armdyn.arm.closed_loop.rollout import has_all_position_commands, simulated_position_errors
from armdyn.arm.model import EFFECTS_STATED_BY_DRIVE, ArmModel
from armdyn.arm.wrench.sensor import unused_wrenches
from armdyn.discovery.discover import discover
from armdyn.discovery.result import Discovery
from armdyn.effects.catalogue import find, find_several
from armdyn.effects.effect import Effect
from armdyn.effects.user import available_effects, load_effects
from armdyn.errors import InputError
from armdyn.identify.compare import Comparison, compare
from armdyn.identify.diagnose import Diagnosis, diagnose
from armdyn.identify.motion.lost_motion import unless_lost
from armdyn.identify.motion.motion_fit import fit_to_motion
from armdyn.identify.motion.motion_study import MotionStudy
from armdyn.identify.repair import Repair, add, fitted_model, model_of_step, repair
from armdyn.identify.selection.search import search
from armdyn.identify.sentence import Verdict
from armdyn.identify.settings import DEFAULT_SETTINGS
from armdyn.identify.studies import make_study
from armdyn.identify.study import Study
from armdyn.inspection.check import MODEL_PLACEHOLDER, Inspection
from armdyn.inspection.inspect import inspect_runs, require_usable
from armdyn.inspection.plausible import require_plausible, with_fitted_values
from armdyn.model import Model
from armdyn.model_file import ModelFile, read_model_file
from armdyn.recording.channels import DriveReading
from armdyn.recording.checks import check_run
from armdyn.run import Run, read_run
from armdyn.threads import one_thread

AnyModel: TypeAlias = Model | Repair | str | Path
"""A model, a repair whose model is meant, or the file of a model."""
Runs: TypeAlias = Sequence[Run | str | Path] | Run | str | Path
"""Recordings or their files; a single one counts as a list of one."""
Say: TypeAlias = Callable[[str], None]


def model_file_of(model: AnyModel) -> ModelFile:
    """The content of a model's file; of a repair with its errors, of a model in memory without a history.

    Raises:
        InputError: the file cannot be read, or is no model's.
    """
    if isinstance(model, Model):
        return ModelFile(model, {})
    if isinstance(model, Repair):
        return ModelFile(model.model, {}, model.history)
    if not isinstance(model, str | Path):
        raise InputError(f"give a model, a repair or the file of a model, not a {type(model).__name__}")
    return read_model_file(model)


def read_runs(given: Runs) -> list[Run]:
    """Read recordings from their files; runs in memory are taken as they are, and a single one gives a list of one.

    Raises:
        InputError: a recording cannot be read.
    """
    each = [given] if isinstance(given, Run | str | Path) else given
    return [run if isinstance(run, Run) else read_run(run) for run in each]


@dataclass(frozen=True)
class ModelWithCatalogue:
    """A model and the effects that it can have.

    Attributes:
        file: the model, with its history.
        catalogue: effects that the model can have: those of the catalogue, of its base and of the user's file.
        path: path of the model's file; ``M.toml`` for a model that was made in memory.
    """

    file: ModelFile
    catalogue: tuple[Effect, ...]
    path: Path = Path(MODEL_PLACEHOLDER)

    @classmethod
    def of(cls, model: AnyModel, effects: Path | None = None) -> "ModelWithCatalogue":
        """Read a model from its file, or take one in memory, and collect the effects that it can have.

        Args:
            model: the model, or its file.
            effects: file of the user's own effects, for a model that is read from a file.

        Raises:
            InputError: a file cannot be used.
        """
        if not isinstance(model, str | Path):
            file = model_file_of(model)
            return cls(file, available_effects(file.model))
        own = load_effects(effects, stages=None)
        file = read_model_file(model, own)
        return cls(file, available_effects(file.model, own, effects), Path(model))

    def inspect(self, runs: Sequence[Run], adding: Sequence[Effect] = ()) -> Inspection:
        """Inspect recordings for mistakes, with this model as a reference.

        Args:
            runs: the recordings.
            adding: effects that the model is about to get, whose values the recordings may state.
        """
        return inspect_runs(runs, self.file.model, self.catalogue, adding).with_model_path(self.path)


@dataclass(frozen=True, eq=False)
class CheckedStudy:
    """A model and inspected recordings, with methods that compare, diagnose, repair and extend the model.

    Each method raises a `WrongRecordingError` if fitted values are physically impossible, unless the recordings are
    trusted.

    Attributes:
        known: the model as given, and the effects that it can have.
        study: the fits; if effects are to be chosen, the model's background of small values is left out.
        effects: effects to choose from.
        inspection: mistakes that were found in the training and held-out runs.
        exam_inspection: mistakes that were found in the exam runs; they change no value, only what their error says.
        trusted: whether to go on where a recording contradicts its declaration.
        declared: the model as its user wrote it, before drives were identified from recordings.
        commanded: training, held-out and exam runs as they were recorded, if they contain positions and their commands
            but no torques, so that effects are chosen by motion; else None.
    """

    known: ModelWithCatalogue
    study: Study
    effects: tuple[Effect, ...]
    inspection: Inspection
    exam_inspection: Inspection
    trusted: bool = False
    declared: Model | None = None
    commanded: tuple[Sequence[Run], Sequence[Run], Sequence[Run]] | None = None

    @classmethod
    def of(
        cls,
        model: ModelWithCatalogue | AnyModel,
        runs: Runs,
        held_out: Runs = (),
        exam: Runs = (),
        *,
        effects: Iterable[Effect] | None = None,
        adding: str = "",
        trusted: bool = False,
    ) -> "CheckedStudy":
        """Inspect recordings for mistakes, and prepare them for fits of a model.

        Args:
            model: the model, or its file.
            runs: recordings to fit, or their files.
            held_out: recordings that help to choose effects, but are never fitted.
            exam: recordings that are used for nothing else: their error is computed at the very end. No value and no
                name depends on them, and mistakes in them are reported but stop nothing.
            effects: effects to choose from; None means all that the model can have.
            adding: effects that the model is about to get (see `find_several`), whose values the recordings may state.
            trusted: go on where a recording contradicts its declaration.

        Raises:
            InputError: a file cannot be read, or the recordings cannot be compared with the model.
            WrongRecordingError: a recording contradicts its declaration, and is not trusted.
        """
        known = model if isinstance(model, ModelWithCatalogue) else ModelWithCatalogue.of(model)
        training, others, last = map(read_runs, (runs, held_out, exam))
        declared = known.file.model
        training, others, last = (
            [declared.with_model_channels(run) for run in given] for given in (training, others, last)
        )
        model = declared.adapted_to(training)
        known = replace(known, file=replace(known.file, model=model))
        coming = find_several(adding, known.catalogue) if adding else ()
        for run in (*training, *others, *last):
            check_run(known.file.model, run, coming)
        # What was recorded is inspected, before a servo's torque is estimated from it. An exam may stop nothing.
        found = known.inspect([*training, *others], coming)
        beside = known.inspect(last, coming) if last else Inspection((), ())
        told = (training, others, last) if predicts_motion(model, training) else None
        training, others, last = (
            [model.with_estimated_channels(run) for run in given] for given in (training, others, last)
        )
        if not trusted:
            require_usable(found)
        by_hand = declared.excluded_effects - {effect.name for effect in coming}
        chosen = tuple(e for e in (known.catalogue if effects is None else effects) if e.name not in by_hand)
        begun = known.file.model.without_background() if chosen else known.file.model
        return cls(
            known, make_study(begun, training, others, chosen, last), chosen, found, beside, trusted, declared, told
        )

    @property
    def set_aside(self) -> tuple[str, ...]:
        """Sentences, without full stops, on parts of the given model that are not used, such as its background."""
        given = self.known.file.model.background
        if given is None or self.study.model.background is not None:
            return ()
        return (f"The {given.label} of the model as given is set aside, to be found anew",)

    def with_effects(self, labels: Sequence[str]) -> "CheckedStudy":
        """A copy with the same recordings and a model that has more effects.

        Args:
            labels: names of the effects, with joints, such as ``"joint_spring:elbow,wrist"``.

        Raises:
            InputError: no effect has such a label, or the model has it already.
        """
        model = self.study.model
        for label in labels:
            model = model.with_effect(find(label, self.known.catalogue))
        return replace(self, study=self.study.with_other_catalogue(self.effects, model)) if labels else self

    def compare(self) -> Comparison:
        """Fit the model and find where it fails."""
        found = compare(self.study)
        model = with_fitted_values(self.study.model, found)
        self._require_plausible(model)
        return self._moving(self._telling(found, model), model)

    def diagnose(self, say: Say | None = None) -> Diagnosis:
        """Find which effect the model lacks."""
        found = diagnose(self.study, say)
        self._require_plausible(fitted_model(self.study, found.search))
        return replace(found, comparison=self._telling(found.comparison))

    def repair(self, say: Say | None = None) -> Repair:
        """Find the effects that the model lacks and add them, until the remaining error is noise or no effect helps.

        Where recordings contain commands but no torques, effects are chosen by the motion.
        """
        return self._repair_torques(say) if self.commanded is None else self._repair_motion(say)

    def _repair_torques(self, say: Say | None) -> Repair:
        """A repair by torques, whose values are then fitted to the motion, where recordings contain commands.

        If an effect has the value zero there, such as a dead band that imitated a wrong delay, the repair is repeated
        without it.
        """
        found = repair(self.study, say)
        self._require_plausible(found.model)
        moved = self._moved(found)
        absent = effects_zero_in_simulation(moved) if moved.model is not found.model else frozenset()
        if not absent:
            return moved
        left = tuple(effect for effect in self.effects if effect.name not in absent)
        return replace(self, study=self.study.with_other_catalogue(left), effects=left)._repair_torques(say)

    def add(self, wanted: Iterable[Effect]) -> Repair:
        """Add effects to the model, one after the other, whether or not the recordings need them, and refit it."""
        found = add(self.study, wanted)
        self._require_plausible(found.model)
        return self._moved(found)

    def discover(self, say: Say | None = None) -> Discovery:
        """Find a formula for the force that the model lacks."""
        return discover(self.study, say)

    def _repair_motion(self, say: Say | None) -> Repair:
        """A repair by the simulated motion; see `MotionModel`."""
        assert self.commanded is not None
        runs, held_out, exam = self.commanded
        arm, declared = (None if m is None else m.capability(ArmModel) for m in (self.study.model, self.declared))
        assert arm is not None
        assert declared is not None
        # No motion shows what is wrong with a torque sensor.
        effects = [effect for effect in self.effects if effect.name not in EFFECTS_STATED_BY_DRIVE]
        model, asked, size = MotionModel.of(arm, declared.drives), self.study.asked, self.study.catalogue_size
        study = MotionStudy(model, runs, held_out, effects, exam, asked, size)
        study.sensed = self._shown_by_wrenches(arm, say)
        found = repair(study, say)
        if (step := study.suited_step(found.steps[-1].fit)) < model.step:
            finer = MotionStudy(replace(model, step=step), runs, held_out, effects, exam, asked, size)
            found = repair(finer.beginning_with(found.model), say)
        whole, alone = (m.capability(ArmModel) for m in (found.model, found.model_without_background))
        assert whole is not None
        assert alone is not None
        self._require_plausible(whole)
        own = {name: p for name, p in found.after.parameters.items() if name in whole.names}
        after = self._moving(self._telling(replace(found.after, parameters=own), whole), whole)
        return unless_lost(replace(found, model=whole, model_without_background=alone, after=after))

    @one_thread
    def _shown_by_wrenches(self, arm: ArmModel, say: Say | None) -> Model | None:
        """The arm with the effects that the wrenches of servo arms show, along the measured motion and without it."""
        assert self.commanded is not None
        runs, held_out = (
            [r for r in those if any(s.recorded(r) for s in arm.sensors.values())] for those in self.commanded[:2]
        )
        if not runs:
            return None
        study = make_study(arm, runs, held_out, self.effects)
        return model_of_step(study, search(study, say).named)

    def _moved(self, found: Repair) -> Repair:
        """A repair with values fitted to the motion, where recordings contain commands, and with its rollout."""
        model, after = found.model, self._telling(found.after)
        arm, declared = (
            model.capability(ArmModel),
            None if self.declared is None else self.declared.capability(ArmModel),
        )
        if arm is not None and declared is not None and found.verdict is not Verdict.LOST:
            model = fit_to_motion(arm, [run.recording for run in self.study.runs], declared.drives)
            values = {
                n: replace(p, value=model.value(n), std=model.parameters[n].std)
                for n, p in after.parameters.items()
                if n in model.names
            }
            after = replace(after, parameters={**after.parameters, **values})
        moved = replace(found, model=model, after=self._moving(after, model))
        judged = unless_lost(moved)
        if judged.verdict is not Verdict.LOST or found.verdict is Verdict.LOST or not self._torques_are_measured:
            return judged
        # Measured torques are what the effects were chosen by; a simulation under their noise proves nothing of them.
        said = f"values are those of the torques: {judged.sentence.removeprefix('lost: ').partition('. ')[0]}"
        kept = replace(moved.after, parameters=found.after.parameters, left_out=(*moved.after.left_out, said))
        return replace(found, after=kept)

    @property
    def _torques_are_measured(self) -> bool:
        """Whether a recording contains a torque that was not estimated from what a drive was told."""
        return any(
            name.startswith("tau.") and not isinstance(channel, DriveReading)
            for run in self.study.runs
            for name, channel in run.recording.channels.items()
        )

    @one_thread
    def _moving(self, found: Comparison, model: Model) -> Comparison:
        """A comparison with the identified drives, and the simulated against the recorded motion."""
        arm = model.capability(ArmModel)
        if arm is None:
            return found
        declared = None if self.declared is None else self.declared.capability(ArmModel)
        return replace(
            found,
            rollout=simulated_position_errors(arm, self.study.recordings),
            drives=arm.drives,
            stated_drives={} if declared is None else declared.drives,
        )

    def _telling(self, found: Comparison, model: Model | None = None) -> Comparison:
        """A comparison with sentences on what was set aside, open questions of a model, and mistakes in exam runs."""
        wrong = self.exam_inspection.wrong
        doubts = [f"the exam {check.run} says little: {check.sentence.rstrip('.')}" for check in wrong]
        told = self.study.model if model is None else model
        questions, arm = told.open_questions, told.capability(ArmModel)
        if arm is not None:
            questions += unused_wrenches(
                arm.sensors, self.inspection.runs, {block.channel for block in found.fit.blocks}
            )
        return replace(found, left_out=(*found.left_out, *self.set_aside, *questions, *doubts))

    def _require_plausible(self, model: Model) -> None:
        if not self.trusted:
            require_plausible(model, self.inspection.runs, self.study.model)


def predicts_motion(model: Model, runs: Sequence[Run]) -> bool:
    """Whether the runs contain positions and position commands of every joint of an arm, and no torque."""
    arm = model.capability(ArmModel)
    return arm is not None and all(
        has_all_position_commands(arm, run) and not any(f"tau.{joint}" in run.channels for joint in arm.joints)
        for run in runs
    )


def effects_zero_in_simulation(found: Repair) -> frozenset[str]:
    """Names of the effects, added by a repair, whose values are zero within their uncertainty in simulated motion."""
    added = {effect for step in found.path for effect in step.added}
    values = [p for p in found.model.parameters.values() if p.effect in added]
    sure = DEFAULT_SETTINGS.search.acceptance_nats
    present = {p.effect for p in values if 0.5 * (p.value - p.null) ** 2 > sure * (p.std or 0.0) ** 2}
    return frozenset(p.effect for p in values if p.effect not in present)
