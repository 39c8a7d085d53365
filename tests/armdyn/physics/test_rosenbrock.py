"""Implicit steps against scipy, and a base that is far too stiff for explicit ones."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from armdyn.physics import Equations, Moment, constant, physics, state
from armdyn.physics.model import physics_model
from armdyn.physics.rosenbrock import rosenbrock_step
from armdyn.physics.stiff import is_stiff
from armdyn.run import Channel, Run

FAST, SECONDS = 2e4, 4.0


def swaying(s, w):
    return [s[1] * w - s[0] ** 2, -s[0] + (ca.sin(w) if isinstance(w, ca.SX) else np.sin(w)) - 0.3 * s[1] * s[0]]


def push(t):
    return 1.0 + 0.5 * np.sin(2.0 * t)


def stepped(h, seconds=2.0):
    """The end of a motion in steps of `h` s."""
    s, w, theta, dt = ca.SX.sym("s", 2), ca.SX.sym("w"), ca.SX.sym("theta", 0), ca.SX.sym("dt")
    rates = ca.Function("rates", [s, w, theta], [ca.vertcat(*swaying([s[0], s[1]], w))])
    three = [ca.SX.sym(f"w{k}") for k in range(3)]
    step = ca.Function("step", [s, *three, dt], [rosenbrock_step(rates, s, tuple(three), theta, dt)])
    state = np.array([1.0, 0.5])
    for k in range(round(seconds / h)):
        state = np.asarray(step(state, *(push((k + part) * h) for part in (0.0, 0.5, 1.0)), h)).ravel()
    return state


def test_halving_the_step_divides_the_error_by_sixteen():
    truth = solve_ivp(lambda t, s: swaying(s, push(t)), (0.0, 2.0), [1.0, 0.5], rtol=1e-12, atol=1e-12).y[:, -1]
    coarse, fine = (np.abs(stepped(h) - truth).max() for h in (0.1, 0.05))
    assert coarse < 1e-6
    assert coarse / fine == pytest.approx(16.0, rel=0.1)


@physics(
    "stiff", summary="a fast state follows a slow one", source="Kirchhoff 1845",
    parameters=(constant("fast", "1/s", FAST), constant("slow", "1/s", 2.0)),
    states=(state("a", "V", typical=1.0), state("b", "V", typical=1.0)), inputs={"extra.u": "V"},
    outputs={"extra.a": "V", "extra.b": "V"}, period=1.0,
)  # fmt: skip
def stiff(at: Moment) -> Equations:
    a, b = at["a"], at["b"]
    return Equations(
        {"a": at["fast"] * (at.input("extra.u").value - 2.0 * a + b), "b": at["slow"] * (a - b)},
        {"extra.a": a, "extra.b": b},
    )


def test_a_stiff_base_is_simulated_in_its_own_steps_as_scipy_does_in_thousands():
    time = np.arange(0.0, SECONDS, 0.02)
    given = np.sin(2.0 * time)
    zeros = {name: Channel(time, np.zeros(len(time)), "V") for name in ("extra.a", "extra.b")}
    model = physics_model(stiff)
    assert is_stiff(model.physics, ())
    run = model.prepare_run(Run("a.csv", {"extra.u": Channel(time, given, "V"), **zeros}))
    found = model.predict(run, model.theta()).values_by_channel
    assert model.input_path(run).dt == pytest.approx(model.step, rel=0.01)
    truth = solve_ivp(
        lambda t, s: [FAST * (np.sin(2.0 * t) - 2.0 * s[0] + s[1]), 2.0 * (s[0] - s[1])], (0.0, SECONDS), [0.0, 0.0],
        "Radau", time, rtol=1e-9, atol=1e-10,
    )  # fmt: skip
    for name, states in zip(("extra.a", "extra.b"), truth.y, strict=True):
        at = run.channels[name].time
        assert np.abs(found[name] - np.interp(at, time, states)).max() < 2e-4
