from dataclasses import replace

import numpy as np
import pytest
from derivatives import assert_jacobian

from armdyn.control.questions import LENGTH_OBJECTIVE, Criterion, information_objective, separation_objective
from armdyn.control.sac import SacSettings, SacState, SequentialActionControl, acceleration_pulse
from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError, UnknownNameError
from armdyn.pendulum.model import pendulum_model
from armdyn.physics.recorded import InputPath
from armdyn.physics.simulate import Simulator

BIAS = CATALOGUE["sensor_bias"]
DRAG = pendulum_model(0.368, 0.08, [CATALOGUE["linear_drag"], BIAS]).with_values({"linear_drag.coefficient": 0.005})
PIVOT = pendulum_model(0.368, 0.08, [CATALOGUE["pivot_viscous_friction"], BIAS]).with_values(
    {"pivot_viscous_friction.coefficient": 7e-4}
)
SWING = np.array([0.2, 0.004])
UNKNOWNS = ("length", "mass", "pivot_viscous_friction.coefficient", "sensor_bias.force")
QUESTIONS = [
    LENGTH_OBJECTIVE,
    information_objective(("length", "linear_drag.coefficient", "mass")),
    information_objective(("length",), ("mass", "sensor_bias.force")),
    information_objective(("length", "linear_drag.coefficient"), ("mass",), Criterion.INVERSE),
    information_objective(("length", "mass"), (), Criterion.DIRECTION, (1.0, 0.5)),
    separation_objective(UNKNOWNS),
]


def situation(question, seed=0):
    """A state in which a good deal is known already."""
    rng = np.random.default_rng(seed)
    m = len(question.parameters)
    root = rng.normal(size=(question.signal_count, question.signal_count))
    psi = rng.normal(size=(2, m)) * [[0.4], [0.01]]
    gram = root @ root.T + 10.0 * np.eye(question.signal_count)
    if question.rivals:
        return SacState(1.0, 0.02, 0.1, SWING, np.zeros((2, 0)), 1.02 * SWING, psi, gram)
    return SacState(1.0, 0.02, 0.1, SWING, psi, gram=gram)


@pytest.fixture(scope="module", params=QUESTIONS, ids=lambda q: f"{q.criterion.value}-{q.signal_count}-{q.rivals}")
def control(request):
    rival = PIVOT if request.param.rivals else None
    return SequentialActionControl(DRAG, question=request.param, rival=rival), rival


def cost_and_gradient(sac, schedule, state, rival):
    cost, gradient = sac._gradient(schedule, *sac._fixed(state, DRAG, rival))
    return cost[0, 0], gradient.ravel().copy()


def test_the_gradient_of_every_criterion_is_exact(control):
    sac, rival = control
    state = situation(sac.question)
    schedule = np.random.default_rng(0).normal(size=sac.settings.steps)
    _, gradient = cost_and_gradient(sac, schedule, state, rival)
    some = np.zeros((6, sac.settings.steps))
    some[np.arange(6), [0, 7, 13, 40, 90, 120]] = 1.0

    def cost(u):
        return np.array(cost_and_gradient(sac, schedule + u @ some, state, rival)[0])

    assert_jacobian(cost, np.zeros(6), some @ gradient, 1e-2, 1e-6)


def test_an_action_lowers_the_cost_of_every_question(control):
    sac, rival = control
    action = sac.act(situation(sac.question), DRAG, rival)
    free, _ = cost_and_gradient(sac, 0.0 * action.schedule, situation(sac.question), rival)
    assert action.cost < free
    cost, _ = cost_and_gradient(sac, action.schedule, situation(sac.question), rival)
    assert action.cost == pytest.approx(cost, rel=1e-9)


def test_criteria_are_those_of_the_inverse_information():
    rng = np.random.default_rng(2)
    root = rng.normal(size=(4, 4))
    G = root @ root.T + np.eye(4)
    covariance = np.linalg.inv(G)[:2, :2]  # of the wanted, the others being unknown
    d = np.array([1.0, -2.0])
    for criterion, direction, expected in (
        (Criterion.DETERMINANT, (), np.log(np.linalg.det(covariance))),
        (Criterion.INVERSE, (), np.log(np.trace(covariance))),
        (Criterion.DIRECTION, tuple(d), np.log(d @ covariance @ d)),
    ):
        cost, slope = information_objective(("a", "b"), ("c", "d"), criterion, direction).criterion_function()(G)
        assert float(cost) == pytest.approx(expected, rel=1e-10)
        steps = 1e-6 * np.eye(16).reshape(16, 4, 4)
        function = information_objective(("a", "b"), ("c", "d"), criterion, direction).criterion_function()
        numeric = [(float(function(G + s)[0]) - float(function(G - s)[0])) / 2e-6 for s in steps]
        np.testing.assert_allclose(numeric, np.asarray(slope).ravel(), rtol=1e-5, atol=1e-7)


def driven(question, rival):
    """Drag and pivot friction over 6 s of closed loop, at true values, from the same kick: what one tells of the other.

    Without a question nothing is done after the kick.

    Returns:
        Separation of the two, and information on the length, 1/m^2.
    """
    sac = question and SequentialActionControl(DRAG, question=question, rival=rival)
    settings = SacSettings()
    first, second = (Simulator(m.dynamics(), f"planar_{m.formulation}", ("load_force",)) for m in (DRAG, PIVOT))
    columns = [PIVOT.physics_names.index(name) for name in UNKNOWNS]
    scales = np.array([PIVOT.parameters[name].typical for name in UNKNOWNS])
    length = DRAG.physics_names.index("length")
    dt, hold = settings.dt, round(settings.sample_time / settings.dt)
    u = np.concatenate([np.full(20, 0.8), np.full(20, -0.8)])
    prior = np.diag([1e-6, 1.0, (0.1 / 8e-4) ** 2, 1.0, 1.0])
    while True:
        if sac is None:
            u = np.pad(u, (0, 600 - len(u)))
        v = np.concatenate([[0.0], np.cumsum(u) * dt])
        x = np.concatenate([[0.0], np.cumsum(v[:-1] * dt + u * dt**2 / 2)])
        path = held(x, v, np.append(u, u[-1]), dt)
        drag = first.rollout(path, DRAG.physics_theta(), 0.0, 0.0)
        pivot = second.rollout(path, PIVOT.physics_theta(), 0.0, 0.0)
        difference = (drag.outputs - pivot.outputs)[:, 0]
        slopes = pivot.sensitivities[:, 0, columns] * scales
        signals = np.column_stack([difference, slopes]) / settings.noise
        gram = prior + dt * signals.T @ signals
        if len(u) >= 600:
            separated = gram[0, 0] - gram[0, 1:] @ np.linalg.solve(gram[1:, 1:], gram[1:, 0])
            return separated, np.sum(drag.sensitivities[:, 0, length] ** 2) * dt / settings.noise**2
        here = SacState(len(u) * dt, x[-1], v[-1], drag.states[-1], drag.state_sensitivities[:, length])
        if question.rivals:
            others = pivot.states[-1], pivot.state_sensitivities[:, columns]
            here = replace(here, sensitivity=np.zeros((2, 0)), rival=others[0], rival_sensitivity=others[1], gram=gram)
        u = np.concatenate([u, sac.act(here, DRAG, rival).schedule[:hold]])


def held(x, v, a, dt):
    """A gripper whose acceleration is held over each step."""
    t, still = dt * np.arange(len(x)), np.zeros((3, len(x)))
    half = np.vstack([t[:-1] + dt / 2, x[:-1] + v[:-1] * dt / 2 + a[:-1] * dt**2 / 8, v[:-1] + a[:-1] * dt / 2])
    return InputPath(0.0, dt, np.vstack([t, x, v, a, still]), np.vstack([half, a[:-1], still[:, 1:]]))


def test_a_motion_tells_what_it_was_asked_for():
    asked = ((None, None), (LENGTH_OBJECTIVE, None), (separation_objective(UNKNOWNS), PIVOT))
    separated, informed = zip(*(driven(*question) for question in asked), strict=True)
    # A horizon of 1.4 s sees little of slow friction: 20 against 8; a motion designed as a whole reaches 60.
    assert separated[2] > 2.0 * separated[1]
    assert informed[1] > 100.0 * informed[0]


def test_questions_that_cannot_be_asked_are_refused(complains):
    with complains(InputError):
        information_objective(())
    with complains(InputError):
        information_objective(("length",), criterion=Criterion.DIRECTION)
    with complains(InputError):
        SequentialActionControl(DRAG, question=separation_objective(UNKNOWNS))
    with complains(UnknownNameError):
        SequentialActionControl(DRAG, question=information_objective(("pivot_viscous_friction.coefficient",)))


MODEL = pendulum_model(0.368, 0.08, [CATALOGUE["linear_drag"]]).with_values({"linear_drag.coefficient": 0.005})


@pytest.fixture(scope="module")
def on_length():
    return SequentialActionControl(MODEL)


def test_from_exact_rest_nothing_moves(on_length):
    still = SacState(0.0, 0.0, 0.0, np.zeros(2), np.zeros(2))
    assert np.all(on_length.act(still, MODEL).schedule == 0.0)


def test_saturation_and_speed_guard_hold(on_length):
    fast = SacState(0.0, 0.0, 0.89, np.array([0.5, 0.01]), np.array([2.0, 0.05]))
    schedule = on_length.act(fast, MODEL).schedule
    assert np.abs(schedule).max() <= on_length.settings.largest_acceleration + 1e-12
    speed = 0.89 + np.cumsum(schedule) * on_length.settings.dt
    assert np.abs(speed).max() <= on_length.settings.largest_speed + 1e-12


def test_the_barrier_turns_the_gripper_round(on_length):
    outside = SacState(0.0, 0.25, 0.1, np.zeros(2), np.array([0.1, 0.0]))
    assert on_length.act(outside, MODEL).acceleration < 0.0


def test_a_needle_keeps_its_impulse_whatever_the_grid():
    schedule = acceleration_pulse(1.5, 0.0234, 0.1178, 80, 0.01)
    assert schedule.sum() * 0.01 == pytest.approx(1.5 * (0.1178 - 0.0234))
    assert np.all(schedule[12:] == 0.0)


def test_settings_that_cannot_work_are_refused(complains):
    with complains(InputError):
        SacSettings(desired_change=1.0)
    with complains(InputError):
        SacSettings(horizon=0.0)
