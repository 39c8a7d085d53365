"""The model of an arm whose position servos follow their commands: it predicts the motion instead of torques.

A servo does not measure its torque, so effects are chosen by what is measured: positions. The closed loop of drives,
effects and rigid bodies is simulated over whole recordings from their first state.
"""

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Self

import numpy as np

from armdyn.arm.closed_loop.motion_slopes import INPUT_DIFFERENCE, window_slopes
from armdyn.arm.closed_loop.rollout import (
    SimulatedWindow,
    SimulationWindow,
    has_all_position_commands,
    simulate_window,
    simulation_windows,
    start_sides,
)
from armdyn.arm.drive_gain.drive_scale import MAX_IDENTIFIED_GAIN_RELATIVE_STD
from armdyn.arm.drives import Servo, gain_unit
from armdyn.arm.model import ArmModel
from armdyn.arm.slots import PLAY_PARAMETER
from armdyn.effects.effect import Effect
from armdyn.model import Kind, Prediction, prediction_from_channels
from armdyn.parameter import Parameter, Prior
from armdyn.run import Channel, Run

SIMULATION_STEPS_SECONDS, SLOPE_STEP_SHARE = (0.004, 0.002, 0.001), 2.0
"""Longest steps of the simulations by which effects are chosen, of which one is chosen (see `MotionStudy`), and the
usual step of their derivatives in such steps."""
TYPICAL_GAIN_SHARE, TYPICAL_DELAY_SECONDS, MAX_DELAY_SECONDS = 0.1, 0.005, 0.2
"""Typical change of a drive's gain, as a share of it, and of its delay, and the largest delay."""
MAX_POSITION_CHANGE = 10.0
"""Change of a position, rad or m, by a typical change of a parameter, beyond which it is that of an unstable motion."""
PLAY_DIFFERENCE = 1e-3
"""Relative change of a play in the difference quotient of a link's way behind its drive."""
CACHED_ARMS = 32
"""Number of arms at different parameters that are cached: all recordings are simulated with the same ones."""
LOST_POSITION = 50.0
"""Position, rad or m, at which a simulation that runs away is held."""


@dataclass(frozen=True, repr=False)
class MotionModel(ArmModel):
    """Model of the motion of an arm whose joints all have position servos, with effects.

    Gain and delay of each kind of drives are parameters, called ``"<kind>.gain"`` and ``"<kind>.delay"``.

    Attributes:
        differentiated: names of the effects by whose parameters predictions are differentiated; None means all.
        step: longest step of the simulation, s.
    """

    differentiated: frozenset[str] | None = None
    step: float = SIMULATION_STEPS_SECONDS[0]

    @classmethod
    def of(cls, model: ArmModel, stated: Mapping[str, Servo]) -> Self:
        """The motion of an arm.

        Args:
            model: the arm, whose drives have a gain and a delay from which fits start.
            stated: the drives as their user declared them: what is known there is a prior, or not fitted.
        """
        own = dict[str, Parameter]()
        for name, servo in model.drives.items():
            assert servo.gain is not None
            given, unit = stated[name].gain, gain_unit(servo.law, model.arm.sliding[servo.joints[0]])
            known = None if given is None or given.std is None else Prior(given.value, given.std)
            own[f"{name}.gain"] = Parameter(
                f"{name}.gain", unit, servo.gain.value, TYPICAL_GAIN_SHARE * servo.gain.value, servo.gain.value,
                lower=1e-3 * servo.gain.value, prior=known, fitted=given is None or given.std is not None,
            )  # fmt: skip
            delay = servo.delay or 0.0
            own[f"{name}.delay"] = Parameter(
                f"{name}.delay", "s", delay, TYPICAL_DELAY_SECONDS, delay, lower=0.0,
                upper=max(MAX_DELAY_SECONDS, delay), fitted=stated[name].delay is None,
            )  # fmt: skip
        parameters = MappingProxyType({**own, **model.parameters})
        return cls(model.effects, parameters, model.arm, model.drives, model.sensors, background=model.background)

    def arm_at(self, theta: np.ndarray) -> ArmModel:
        """The arm with the values and drives at (p,) parameters `theta`; the last few are cached."""
        key = theta.tobytes()
        if key not in self._arms:
            if len(self._arms) >= CACHED_ARMS:
                del self._arms[next(iter(self._arms))]
            self._arms[key] = self._arm_with(dict(zip(self.names, theta.tolist(), strict=True)))
        return self._arms[key]

    @cached_property
    def _arms(self) -> dict[bytes, ArmModel]:
        return {}

    def _arm_with(self, values: Mapping[str, float]) -> ArmModel:
        drives = {
            name: replace(
                servo,
                gain=replace(servo.gain, value=values[f"{name}.gain"]),
                delay=values[f"{name}.delay"],
            )
            for name, servo in self.drives.items()
            if servo.gain is not None
        }
        kept = {n: replace(p, value=values[n]) for n, p in self.parameters.items() if p.effect}
        return ArmModel(self.effects, MappingProxyType(kept), self.arm, MappingProxyType(drives), self.sensors)

    def capability(self, kind: type[Kind]) -> Kind | None:
        """See `Model.capability`; as an `ArmModel` it is the arm with its values, which predicts torques."""
        return (
            super().capability(kind) if issubclass(kind, MotionModel) else self._predicting_torques().capability(kind)
        )

    def _predicting_torques(self) -> ArmModel:
        """The arm with the values, drives and uncertainties of this model, which predicts torques."""
        drives = dict(self.arm_at(self.theta()).drives)
        for name, servo in drives.items():
            std, read = self.parameters[f"{name}.gain"].std, self.drives[name]
            if servo.gain is None or read.gain is None or std is None:
                continue
            # A load that nobody knows looks like another gain, in the motion as well.
            known = read.gain.std or 0.0
            alone = known if read.unloaded is None else read.unloaded
            loads = max(known**2 - alone**2, 0.0) ** 0.5 * servo.gain.value / read.gain.value
            whole = float(np.hypot(std, loads))
            sure = std < MAX_IDENTIFIED_GAIN_RELATIVE_STD * servo.gain.value
            drives[name] = replace(servo, gain=replace(servo.gain, std=whole), unloaded=std, determined=sure)
        kept = MappingProxyType({n: p for n, p in self.parameters.items() if p.effect})
        small = self.background
        if small is not None:
            small = replace(small, named_only={n: value for n, value in small.named_only.items() if n in kept})
        return ArmModel(self.effects, kept, self.arm, MappingProxyType(drives), self.sensors, background=small)

    def can_show(self, effect: Effect, channels: Collection[str]) -> bool:
        """Whether an effect is visible in a motion, or in a wrench beside it; see `Model.can_show`."""
        return effect.is_visible_in(channels)

    def reduced_model(self, needed: Collection[str], runs: Sequence[Run]) -> Self:
        """The same model, so that all sets of effects share one compiled simulator, with fewer derivatives."""
        del runs
        return replace(self, differentiated=frozenset(needed))

    def predicted_channels(self, run: Run) -> tuple[str, ...]:
        """Names of the positions of joints that move, if the run has a command of every joint, and of its wrenches."""
        if not has_all_position_commands(self, run):
            return ()
        names = [f"q.{joint}" for joint in self.arm.joints]
        moving = [n for n in names if n in run.channels and np.ptp(run.channels[n].value) > 0.0]
        return (*moving, *self._wrenches(run))

    def prepare_run(self, run: Run, beside: Sequence[Run] = ()) -> Run:
        """The run with the positions of all joints at the stamps at which the simulation is compared with them.

        It says which joints are not compared, as they do not move. Wrenches are low-passed, as beside torques.
        """
        window = _window(run, self.arm.joints)
        if all(len(run.channels[f"q.{joint}"]) == len(window.time) for joint in self.arm.joints):
            return run
        still = [joint for joint in self.arm.joints if f"q.{joint}" not in self.predicted_channels(run)]
        if still:
            run = replace(run, warnings=(*run.warnings, f"not compared, as at rest: {', '.join(still)}"))
        cut = {
            name: Channel(window.time, window.q[:, j], run.channels[name].unit)
            for j, name in enumerate(f"q.{joint}" for joint in self.arm.joints)
        }
        wrenches = self._wrenches(run)
        prepared = super().prepare_run(run, beside) if wrenches else run
        low_passed = {name: prepared.channels[name] for name in wrenches}
        found = replace(prepared, channels={**run.channels, **cut, **low_passed})
        found.__dict__["_window"] = window
        return found

    def without_predictions(self, run: Run, names: Collection[str]) -> Run:
        """A copy of a run in which joints that are not predicted rest, as a simulation needs all positions."""
        run = super().without_predictions(run, [name for name in names if not name.startswith("q.")])
        still = {name: run.channels[name] for name in names if name in run.channels}
        still = {name: Channel(c.time, np.full(len(c), c.value[0]), c.unit) for name, c in still.items()}
        return replace(run, channels={**run.channels, **still})

    def noise(self, run: Run, theta: np.ndarray) -> Mapping[str, float]:
        """Noise of the wrenches: that of positions does not depend on the parameters."""
        arm = self.arm_at(theta)
        return arm.noise(run, arm.theta()) if self._wrenches(run) else {}

    def force_channels(self, run: Run) -> Mapping[str, str]:
        """Nothing: a position's residual is not a force."""
        del run
        return {}

    def predict_values(self, run: Run, theta: np.ndarray) -> Mapping[str, np.ndarray]:
        """(n,) simulated positions by channel."""
        window, found = _window(run, self.arm.joints), self._simulated(run, theta)
        arm = self.arm_at(theta)
        with np.errstate(all="ignore"):
            read = _held(found.links_at(arm, arm.theta(), window.time))
        wrenches = arm.predict_values(run, arm.theta()) if self._wrenches(run) else {}
        return {**{f"q.{joint}": read[:, j] for j, joint in self._moving(run)}, **wrenches}

    def predict(self, run: Run, theta: np.ndarray) -> Prediction:
        """Simulate the positions of a run, with their derivatives by the parameters; see `motion_slopes`."""
        arm, window = self.arm_at(theta), _window(run, self.arm.joints)
        own, places = self._wanted, self._of_drives
        others = [self._drive_parameter(theta, i) for i in places]
        with np.errstate(all="ignore"):
            found = self._simulated(run, theta)
            wanted, changed = [arm.names.index(self.names[i]) for i in own], [model for model, _ in others]
            slopes = window_slopes(arm, changed, window, found, SLOPE_STEP_SHARE * self.step, wanted)
            read = found.links_at(arm, arm.theta(), window.time)
        by = np.zeros((len(window.time), len(arm.arm.joints), len(theta)))
        by[:, :, own] = slopes[:, :, : len(own)]
        of_play = [self.names[i].startswith(f"{PLAY_PARAMETER}[") for i in own]
        if any(of_play):
            with np.errstate(all="ignore"):
                begun, sides = start_sides(arm, arm.theta(), window), found.sides_at(arm, arm.theta(), window.time)
            for i in np.array(own)[of_play].tolist():
                j = self.arm.joints.index(self.parameters[self.names[i]].joint)
                by[:, :, i] += begun[j] * slopes[:, :, len(own) + len(places) + j]
                by[:, j, i] -= self._lag_slope(found, theta, window.time, (i, j), sides[:, j])
        with np.errstate(all="ignore"):  # a motion may run away
            by[:, :, places] = slopes[:, :, len(own) : len(own) + len(places)] / np.array([c for _, c in others])
        most = MAX_POSITION_CHANGE / np.array([p.typical for p in self.parameters.values()])
        by = np.clip(np.nan_to_num(by), -most, most)
        parts = [(f"q.{joint}", window.time, _held(read[:, j]), by[:, j]) for j, joint in self._moving(run)]
        if self._wrenches(run):
            wrench = arm.predict(run, arm.theta())
            of_all = np.zeros((len(wrench.time), len(theta)))
            of_all[:, [self.names.index(name) for name in arm.names]] = wrench.sensitivities
            parts += [(n, wrench.time[rows], wrench.values[rows], of_all[rows]) for n, rows in wrench.slices.items()]
        return prediction_from_channels(parts)

    def _lag_slope(
        self, found: SimulatedWindow, theta: np.ndarray, time: np.ndarray, where: tuple[int, int], sides: np.ndarray
    ) -> np.ndarray:
        """(n,) derivative of a link's way behind its drive by its play.

        Args:
            found: the motion of the drives.
            theta: (p,) parameters.
            time: (n,) increasing times, s.
            where: indices of the play among the parameters, and of its joint.
            sides: (n,) places of the link in its play.
        """
        i, j = where
        if theta[i] <= 0.0:
            return sides
        moved = theta.copy()
        moved[i] *= 1.0 + PLAY_DIFFERENCE
        arm = self.arm_at(moved)
        with np.errstate(all="ignore"):
            there = found.sides_at(arm, arm.theta(), time)[:, j]
        return np.asarray(there + (there - sides) / PLAY_DIFFERENCE)

    @np.errstate(all="ignore")
    def _simulated(self, run: Run, theta: np.ndarray) -> SimulatedWindow:
        """The simulated motion of a run; the last one of each run is kept, as its derivatives are asked for next."""
        key = (self.names, self.arm, tuple(self.drives.values()), self.step, theta.tobytes())
        known: tuple[Hashable, SimulatedWindow] | None = run.__dict__.get("_simulated")
        if known is None or known[0] != key:
            arm = self.arm_at(theta)
            servos = [arm.servo(joint) for joint in arm.arm.joints]
            window = _window(run, self.arm.joints)
            known = key, simulate_window(arm, arm.theta(), window, servos, self.step)
            run.__dict__["_simulated"] = known
        return known[1]

    @property
    def _wanted(self) -> list[int]:
        """Indices of the parameters of effects by which predictions are differentiated, but for `_of_drives`."""
        wanted, drives = self.differentiated, set(self._of_drives)
        return [
            i
            for i, p in enumerate(self.parameters.values())
            if i not in drives and p.joint not in self.sensors and (wanted is None or p.effect in wanted)
        ]

    @property
    def _of_drives(self) -> list[int]:
        """Indices of the parameters that act through the drives' inputs."""
        names = self.names
        return [
            i for i, name in enumerate(names) if not self.parameters[name].effect or name.startswith("command_delay.")
        ]

    def _drive_parameter(self, theta: np.ndarray, i: int) -> tuple[ArmModel, float]:
        """The arm with one parameter changed slightly, and the change."""
        change = INPUT_DIFFERENCE * (theta[i] if self.names[i].endswith(".gain") else 1.0)
        if theta[i] + change > self.parameters[self.names[i]].upper:
            change = -change
        moved = theta.copy()
        moved[i] += change
        return self.arm_at(moved), change

    def _wrenches(self, run: Run) -> list[str]:
        """Channels of force/torque sensors, predicted along the measured motion: no drive acts on what they carry."""
        return [name for sensor in self.sensors.values() for name in sensor.recorded(run)]

    def _moving(self, run: Run) -> list[tuple[int, str]]:
        """Indices and names of the joints that are predicted."""
        return [(j, joint) for j, joint in enumerate(self.arm.joints) if f"q.{joint}" in self.predicted_channels(run)]


def _held(positions: np.ndarray) -> np.ndarray:
    """Positions within `LOST_POSITION`, also where a simulation ran away."""
    return np.clip(np.nan_to_num(positions, nan=LOST_POSITION), -LOST_POSITION, LOST_POSITION)


def _window(run: Run, joints: tuple[str, ...]) -> SimulationWindow:
    """The simulated part of a whole recording, of which a prepared run has the positions alone."""
    known: SimulationWindow | None = run.__dict__.get("_window")
    return simulation_windows(run, joints, np.inf)[0] if known is None else known
