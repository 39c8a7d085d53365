"""Cases of the estimator's benchmark: recordings, models and start values, the same for armdyn and its rivals."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from _pendulum import Pendulum, sum_of_cosines
from _rival_fits import NAMES, Data, Fit, over_windows, with_floats

from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.estimator import Estimate, Estimator
from armdyn.pendulum.model import PendulumModel, pendulum_model
from armdyn.recording.gaps import run_until
from armdyn.run import Channel, Run

MOTION = sum_of_cosines((0.04, 0.012), (0.6, 1.15))
TIME = 0.01 * np.arange(1, 1001)
NOISE = 0.01
LENGTH, MASS = 0.368, 0.1
TRUTH = dict(zip(NAMES, (LENGTH, 0.1003, 0.008, 0.01, 0.008), strict=True))
"""True parameters of the run in which all parameters are fitted."""
FIXED = {"mass": MASS, "drag": 0.0, "bias": 0.0, "delay": 0.0}
"""Values of the fixed parameters in the cases that fit only the length."""
KNOWN = {"mass": (0.1, 0.001), "drag": (0.0, 0.01), "bias": (0.0, 0.02), "delay": (0.01, 0.01)}
OUR_NAMES = ("length", "mass", "linear_drag.coefficient", "sensor_bias.force", "sensor_delay.time")


WINDOWS = (0.75, 1.5, 3.0, 6.0)
"""Ends of the growing windows of a fit from a distant start [s]; the last fit takes the whole recording."""


@dataclass(frozen=True)
class Scenario:
    """One estimation problem.

    Attributes:
        data: problem and start values for the rivals.
        run: the recording for armdyn.
        model: model with the start values for armdyn.
        windows: whether the fit passes over growing windows, as from a distant start.
    """

    data: Data
    run: Run
    model: PendulumModel
    windows: bool

    def ours(self) -> Estimate:
        """Estimate by armdyn."""
        estimator, begin = Estimator(self.model, {"load_force": NOISE}), self.run.channels["load_force"].time[0]
        for window in WINDOWS if self.windows else ():
            estimator.update(run_until(self.run, begin + window))
        return estimator.update(self.run)

    def theirs(self, fit: Fit) -> np.ndarray:
        """Free parameters that a rival finds."""
        return over_windows(fit, self.data, WINDOWS) if self.windows else fit(self.data)


def recording(force: np.ndarray) -> Run:
    """Run of the gripper's motion, which is known from time 0 on, and of a force at each time of `TIME`."""
    t = np.insert(TIME, 0, 0.0)
    path = {"gripper_x": (MOTION.x, "m"), "gripper_v": (MOTION.v, "m/s"), "gripper_a": (MOTION.a, "m/s^2")}
    channels = {name: Channel(t, signal(t), unit) for name, (signal, unit) in path.items()}
    return Run("benchmark", {**channels, "load_force": Channel(TIME, force, "N")}, noise={"gripper_x": 0.0})


def simple_model(length: float, mass: float = MASS) -> PendulumModel:
    """Pendulum model whose only fitted parameter is the length."""
    return pendulum_model(length, mass).with_fixed("mass", "initial_angle", "initial_rate")


def full_model(length: float) -> PendulumModel:
    """Pendulum model that fits length, mass, drag, bias and delay."""
    model = pendulum_model(length, MASS).with_fixed("initial_angle", "initial_rate")
    for name in ("linear_drag", "sensor_bias", "sensor_delay"):
        model = model.with_effect(CATALOGUE[name])
    for name, ours in zip(NAMES, OUR_NAMES, strict=True):
        if name in KNOWN:
            model = model.with_prior(ours, *KNOWN[name])
    return model


def length_force(data: Path | None) -> np.ndarray:
    """Force of the run in which only the length is unknown (1000,) [N]: column 7 of a recording of `MOTION`."""
    if data is not None:
        return np.loadtxt(data, delimiter=",", skiprows=1)[:, 6]
    return Pendulum(LENGTH, MASS).simulate(MOTION, TIME)[1] + NOISE * np.random.default_rng(0).normal(size=len(TIME))


def full_force() -> np.ndarray:
    """Force of the run in which all parameters are unknown (1000,) [N]."""
    pendulum = Pendulum(TRUTH["length"], TRUTH["mass"], TRUTH["drag"])
    late = np.maximum(TIME - TRUTH["delay"], 0.0)
    force = pendulum.simulate(MOTION, late)[1] + TRUTH["bias"]
    return force + NOISE * np.random.default_rng(0).normal(size=len(TIME))


@cache
def scenarios(data: Path | None) -> dict[str, Scenario]:
    """Cases by name: the length or all parameters, from an earlier estimate, 2 mm beside or 20 % beside the truth."""
    return {
        f"{what}, {where}": scenario
        for what, everything in (("length", False), ("five parameters", True))
        for where, scenario in _starts(full_force() if everything else length_force(data), everything).items()
    }


def _starts(force: np.ndarray, everything: bool) -> dict[str, Scenario]:
    run, make = recording(force), full_model if everything else simple_model
    free, known = (NAMES, KNOWN) if everything else (("length",), {})
    values = np.array([LENGTH + 0.002, *(known.get(name, (fixed, 0.0))[0] for name, fixed in FIXED.items())])
    near = Data(TIME, force, NOISE, MOTION, known, free, values)
    earlier = with_floats(near.until(TIME[-1] - 0.5))
    warm = make(LENGTH).with_values({OUR_NAMES[i]: float(v) for i, v in zip(near.columns, earlier, strict=True)})
    far = near.with_start(np.array([1.2 * LENGTH, *values[near.columns[1:]]]))
    return {
        "0.5 s later": Scenario(near.with_start(earlier), run, warm, False),
        "2 mm off": Scenario(near, run, make(LENGTH + 0.002), False),
        "20 % off": Scenario(far, run, make(1.2 * LENGTH), True),
    }
