"""The regressor of an arm's torques: their derivatives with respect to each unknown at every instant of a motion.

The axes of force/torque sensors are further rows of it, after the joints.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import erf

from armdyn.arm.arm import Arm
from armdyn.arm.bodies import MotionSamples
from armdyn.arm.model import ArmModel
from armdyn.arm.motion import Motion
from armdyn.experiments.series import AxisMotion
from armdyn.parameter import Parameter

TORQUE_NOISE_SHARE_OF_EFFORT_LIMIT = 2e-3
"""Standard deviation of a torque sample, as a share of the joint's effort limit, if the noise is not known. Recordings
of Baxter have 0.05 to 0.10 N m on joints of 50 N m and 0.014 to 0.07 N m on joints of 15 N m."""
WRENCH_NOISE = (0.1, 0.1, 0.1, 0.005, 0.005, 0.005)
"""Standard deviations of a sample of a force/torque sensor at a wrist, N and N m, if the noise is not known."""
SLOW_SHARE_OF_SPEED_LIMIT = 0.02
"""Speed below which a joint's direction of motion is uncertain, as a share of its speed limit."""
REGRESSION_PRIOR_STD_TYPICAL_SIZES = 10.0
"""Prior standard deviation of an unknown before the recording, in typical sizes, as in a repair's fits."""
RANDOM_STATES_FOR_ACTIVE_PARAMETERS = 50
"""Number of random states at which torques are differentiated to find unknowns that act only through another
unknown."""
STATE_DIFFERENCE = 1e-5
"""Step of finite differences of torques by positions, rad, velocities, rad/s, and accelerations, rad/s^2."""
MotionGradient = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


LONGEST_RANDOM_TIME_SECONDS = 20.0
"""Time since the start of a run up to which random states are drawn, s."""


@dataclass(frozen=True, eq=False)
class EarlierRuns:
    """Recordings before the designed motion: what they contain, how noisy it is, and how the arm moved.

    Attributes:
        noise: (nc,) standard deviations of a sample of each torque, N m or N, and of each axis of the sensors, N and
            N m, at the sampling rate of the designed recording; infinite for those that no run contains.
        motions: of each run n states of the arm, (n,) times since its start, s, and the number of samples that a
            recording with the designed rate has for each of them.
    """

    noise: np.ndarray
    motions: tuple[tuple[AxisMotion, np.ndarray, float], ...] = ()


@dataclass(frozen=True, eq=False)
class TorqueRegressor:
    """Regressor of an arm's torques: one column for each unknown of its model.

    Attributes:
        model: model with every effect that is wanted or may be present, at the values of
            `with_all_parameters_active`.
        rate: sampling rate of the recording, Hz.
        earlier: recordings that there are already; None without any, where all torques and sensors are recorded.
    """

    model: ArmModel
    rate: float
    earlier: EarlierRuns | None = None

    @property
    def arm(self) -> Arm:
        """The arm as its description states it, without effects."""
        return self.model.arm

    @cached_property
    def unknowns(self) -> tuple[Parameter, ...]:
        """(P,) unknown parameters in the order of the columns."""
        return tuple(self.model.parameters.values())

    @cached_property
    def typical(self) -> np.ndarray:
        """(P,) typical sizes of the unknowns, in their units; a column is for a change of this size."""
        return np.array([p.typical for p in self.unknowns])

    @cached_property
    def prior(self) -> np.ndarray:
        """(P,) prior standard deviations of the unknowns, in typical sizes."""
        stds = [p.prior.std / p.typical if p.prior else REGRESSION_PRIOR_STD_TYPICAL_SIZES for p in self.unknowns]
        return np.minimum(stds, REGRESSION_PRIOR_STD_TYPICAL_SIZES)

    @cached_property
    def noise(self) -> np.ndarray:
        """(nc,) standard deviation of a torque sample, N m or N, and then of each axis of the sensors."""
        if self.earlier is not None:
            return self.earlier.noise
        torques = TORQUE_NOISE_SHARE_OF_EFFORT_LIMIT * np.asarray(self.arm.robot.limits.effort)
        return np.concatenate([torques, np.tile(WRENCH_NOISE, len(self.model.sensors))])

    def column_indices(self, effect: str, joint: str | None = None) -> np.ndarray:
        """Column indices of an effect's unknowns, on one joint or on all."""
        return np.flatnonzero([p.effect == effect and joint in (None, p.joint) for p in self.unknowns])

    @cached_property
    def information_of_earlier_runs(self) -> np.ndarray:
        """(P, P) Fisher information of the recordings that there are already."""
        found = np.zeros((len(self.unknowns), len(self.unknowns)))
        for motion, time, weight in self.earlier.motions if self.earlier is not None else ():
            X = self.values_along(motion, time).reshape(-1, len(found))
            found += weight * X.T @ X
        return found

    def values_along(self, motion: AxisMotion, time: np.ndarray | None = None) -> np.ndarray:
        """(n, nc, P) regressor along a motion: changes of readings over their noise, for changes of typical size.

        (n,) times since the start of the run, s, matter for drifts; None where there is none.
        """
        return self._columns(self._states(motion, time))

    def described_torque(self, motion: AxisMotion) -> np.ndarray:
        """(n, nj) motor torques of the arm as described, N m or N, with damping, friction, rotors and springs."""
        return self._torque(self._states(motion))

    def _states(self, motion: AxisMotion, time: np.ndarray | None = None) -> MotionSamples:
        slow = SLOW_SHARE_OF_SPEED_LIMIT * np.asarray(self.arm.robot.limits.velocity)
        direction = erf(motion.v / (np.sqrt(2.0) * slow))
        time = np.zeros(len(motion.q)) if time is None else time
        return MotionSamples(self.arm.model, Motion(time, motion.q, motion.v, motion.a, direction), time)

    def _columns(self, states: MotionSamples) -> np.ndarray:
        found = [self.model.at_states(states)[1], self.model.wrenches_at_states(states)]
        return np.concatenate(found, axis=1) * (self.typical / self.noise[:, None])

    def _torque(self, states: MotionSamples) -> np.ndarray:
        robot, motion = self.arm.robot, states.motion
        springs = robot.spring_torque(motion.q, [spring for spring in robot.springs if spring.enabled])
        drives = np.asarray(robot.model.damping) * motion.v + np.asarray(robot.model.armature) * motion.a
        drives = drives + np.asarray(robot.model.upperDryFrictionLimit) * motion.direction
        return states.described + drives + springs

    def with_gradient(
        self, motion: AxisMotion, time: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, MotionGradient]:
        """The regressor and the torques along a motion, with a function for derivatives by the motion.

        The (n,) times are those of `values_along`.

        Returns:
            (n, nc, P) regressor, (n, nj) torques, and a function: from the derivatives of a number with respect to
            both it computes those with respect to positions, velocities and accelerations, (n, nj) each.
        """
        n, nj = motion.q.shape
        shifts = np.vstack([np.zeros((1, 3 * nj)), STATE_DIFFERENCE * np.eye(3 * nj)])
        parts = (motion.q, motion.v, motion.a)
        moved = ((part + shifts[:, None, k * nj : (k + 1) * nj]).reshape(-1, nj) for k, part in enumerate(parts))
        states = self._states(AxisMotion(*moved), None if time is None else np.tile(time, len(shifts)))
        columns = self._columns(states)
        columns = columns.reshape(1 + 3 * nj, n, *columns.shape[1:])
        torque = self._torque(states).reshape(1 + 3 * nj, n, nj)

        def gradient(by_columns: np.ndarray, by_torque: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            whole = np.einsum("dnjp,njp->dn", columns[1:], by_columns, optimize=True)
            whole -= np.einsum("njp,njp->n", columns[0], by_columns)
            whole += np.einsum("dnj,nj->dn", torque[1:], by_torque)
            whole -= np.einsum("nj,nj->n", torque[0], by_torque)
            q, v, a = (whole / STATE_DIFFERENCE).reshape(3, nj, n).transpose(0, 2, 1)
            return q, v, a

        return columns[0], torque[0], gradient


def with_all_parameters_active(model: ArmModel) -> ArmModel:
    """The model at parameter values at which torques depend on all parameters of its effects.

    Effects are at their null values, except where a parameter acts through another one, as a payload's place acts
    through its mass: then the other one is at its typical size.
    """
    count = RANDOM_STATES_FOR_ACTIVE_PARAMETERS
    columns = TorqueRegressor(model, 1.0).values_along(random_joint_states(model.arm, count), random_times(count))
    acts = dict(zip(model.names, np.any(columns != 0.0, axis=(0, 1)).tolist(), strict=True))
    changed = {}
    for effect in model.effects:
        for names in model.parameter_names_by_joint(effect.name).values():
            acting = [name for name in names if acts[name]]
            if acting and len(acting) < len(names):
                driver = model.parameters[acting[0]]
                size = driver.typical if driver.upper > driver.value else -driver.typical
                changed[driver.name] = float(np.clip(driver.value + size, driver.lower, driver.upper))
    return model.with_values(changed) if changed else model


def random_joint_states(arm: Arm, count: int) -> AxisMotion:
    """Random positions, velocities and accelerations (count, nj) within the arm's limits, from a fixed seed."""
    rng, limits = np.random.default_rng(0), arm.robot.limits
    shape = (count, len(arm.joints))
    lower, upper = (np.clip(bound, -2.0 * np.pi, 2.0 * np.pi) for bound in (limits.lower, limits.upper))
    q = rng.uniform(lower, upper, shape)
    v, a = (rng.uniform(-1.0, 1.0, shape) * np.asarray(x) for x in (limits.velocity, limits.acceleration))
    return AxisMotion(q, v, a)


def random_times(count: int) -> np.ndarray:
    """(count,) random times since the start of a run, s, from a fixed seed."""
    return np.random.default_rng(1).uniform(0.0, LONGEST_RANDOM_TIME_SECONDS, count)
