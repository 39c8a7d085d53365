"""Learning the length in closed loop on a pendulum of the benchmarks' own, whose gripper follows commands exactly."""

from dataclasses import dataclass

import numpy as np
from _pendulum import Motion, Pendulum
from scipy.interpolate import CubicHermiteSpline

from armdyn.control.sac import SacSettings, SacState, SequentialActionControl
from armdyn.estimation.descent import descend
from armdyn.identify.estimator import Estimate, Estimator, MinimiseFunction
from armdyn.pendulum.model import PendulumModel
from armdyn.pendulum.path import gripper_path
from armdyn.run import Channel, Run

DT = 0.01
"""Period of the samples of load cell and gripper [s]."""
ACT_EVERY, ESTIMATE_EVERY, FIRST_ESTIMATE = 5, 50, 100
"""Number of samples between actions, between estimates, and before the first estimate."""
KICK, KICK_SAMPLES = 0.8, 20
"""Acceleration [m/s^2] and samples of each half of the doublet that starts the motion; from rest SAC never moves."""


@dataclass(frozen=True)
class Trial:
    """Motion, recording and estimates of one simulated trial.

    Attributes:
        motion: motion of the gripper.
        run: recording of gripper and load cell.
        estimates: one every half second from 1 s on.
        evaluations: number of evaluations of the model in all estimates.
    """

    motion: Motion
    run: Run
    estimates: tuple[Estimate, ...]

    @property
    def length(self) -> float:
        """Length of the last estimate [m]."""
        return self.estimates[-1].value("length")

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the model in all estimates."""
        return sum(estimate.evaluations for estimate in self.estimates)


def learn(
    truth: Pendulum,
    model: PendulumModel,
    duration: float,
    noise: float,
    rng: np.random.Generator,
    minimise: MinimiseFunction = descend,
) -> Trial:
    """Simulated trial: a doublet starts the motion, then SAC acts 20 times a second on the latest estimate.

    Args:
        truth: pendulum that is simulated.
        model: model of the first guess; its `fitted` parameters are estimated.
        duration: duration of the trial [s].
        noise: standard deviation of the load cell [N].
        rng: random generator of the noise.
        minimise: method of the estimator.
    """
    samples = round(duration / DT)
    estimator, control = (
        Estimator(model, {"load_force": noise}, minimise),
        SequentialActionControl(model, SacSettings()),
    )
    gripper, force = np.zeros((3, samples + 1)), np.zeros(samples + 1)  # x, v, a
    schedule = np.repeat([KICK, -KICK], KICK_SAMPLES).tolist()
    load, estimates = (0.0, 0.0), []
    for k in range(samples + 1):
        x, v, a = gripper[:, k]
        force[k] = truth.tension(*load, v, a) + noise * rng.normal()
        run = recording(gripper[:, : k + 1], force[: k + 1])
        if k >= FIRST_ESTIMATE and k % ESTIMATE_EVERY == 0:
            estimates.append(estimator.update(run))
        if k >= 2 * KICK_SAMPLES and k % ACT_EVERY == 0:
            schedule = control.act(_now(estimator.model, run, x, v), estimator.model).schedule.tolist()
        if k < samples:
            u = schedule.pop(0)
            load = truth.advance(load, v, u, DT)
            # The sample at the end of an interval has the acceleration of that interval: it is the past that is known.
            gripper[:, k + 1] = x + DT * v + DT**2 / 2 * u, v + DT * u, u
    return Trial(held(gripper), run, tuple(estimates))


def recording(gripper: np.ndarray, force: np.ndarray) -> Run:
    """Run with the gripper's x, v, a (3, n) and the force (n,) at the samples."""
    time = DT * np.arange(len(force))
    channels = {
        name: Channel(time, values.copy(), unit)
        for name, values, unit in zip(
            ("gripper_x", "gripper_v", "gripper_a", "load_force"), (*gripper, force), ("m", "m/s", "m/s^2", "N"),
            strict=True,
        )
    }  # fmt: skip
    return Run("learning", channels, noise={"gripper_x": 0.0})


def held(gripper: np.ndarray) -> Motion:
    """Motion through the samples x, v, a (3, n), with constant acceleration between them."""
    time = DT * np.arange(gripper.shape[1])
    position = CubicHermiteSpline(time, gripper[0], gripper[1])
    velocity = position.derivative()

    def acceleration(t: np.ndarray) -> np.ndarray:
        return gripper[2][np.clip(np.ceil(np.asarray(t) / DT - 1e-9).astype(int), 0, len(time) - 1)]

    return Motion(position, velocity, acceleration)


def _now(model: PendulumModel, run: Run, x: float, v: float) -> SacState:
    rollout = model.rollout(gripper_path(run), model.theta(), channels=("load_force",))
    sensitivity = rollout.state_sensitivities[:, model.physics_names.index("length")]
    return SacState(float(run.channels["load_force"].time[-1]), x, v, rollout.states[-1], sensitivity)
