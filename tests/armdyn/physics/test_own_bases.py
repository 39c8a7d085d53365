"""Bases of one's own, on data from scipy: first-order states, values far off, states that nothing shows, lost fits."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from command import called
from scipy.integrate import solve_ivp

from armdyn.checked_study import CheckedStudy
from armdyn.discovery.physics import physics_formula_candidates
from armdyn.effects.effect import effect
from armdyn.errors import TaskFailedError
from armdyn.front import compare, fit, repair
from armdyn.identify.sentence import Verdict
from armdyn.inspection.plausible import implausible_values
from armdyn.parameter import quantity
from armdyn.physics import Equations, Expression, Stage, constant, physics, state
from armdyn.physics.model import physics_model
from armdyn.physics.user import load_base
from armdyn.run import Channel, Run, write_run_csv

STIFFNESS, DAMPING, INERTIA = 30.0, 0.8, 1.0
OSCILLATOR = '''
"""A mass on a spring that is pushed; free motions show ratios only, and of the inertia a known part is taken off."""

from armdyn.physics import Equations, constant, physics, state


@physics(
    "oscillator", summary="A mass on a spring.", source="Goldstein, Classical Mechanics, 3rd ed., §6.1",
    parameters=(
        constant("stiffness", "N/m", 30.0, lower=0.1, upper=1e4),
        constant("damping", "N s/m", 0.8, lower=0.0),
        constant("inertia", "kg", 1.0, lower=0.1, upper=10.0),
    ),
    states=(state("place", "m", typical=0.1), state("speed", "m/s", typical=0.5)),
    inputs={"tau.push": "N"}, outputs={"q.mass": "m"}, period=1.0,
)
def oscillator(at):
    force = at.input("tau.push").value - at["stiffness"] * at["place"] - at["damping"] * at["speed"]
    rates = {"place": at["speed"], "speed": force / (at["inertia"] - 0.5)}
    return Equations(rates, {"q.mass": at["place"]})
'''


VESSEL = '''
"""A heated vessel, in units of its own."""

import casadi as ca

from armdyn.effects.effect import effect
from armdyn.parameter import quantity
from armdyn.physics import Equations, constant, physics, state


@physics(
    "vessel", summary="A heated vessel that is filled.", source="Newton 1701",
    parameters=(constant("loss", "1/min", 0.3, lower=1e-3), constant("area", "l/mm", 2.0, lower=1e-2)),
    states=(state("inside", "degC", typical=20.0, start=30.0), state("level", "mm", typical=50.0, start=20.0)),
    inputs={"extra.flow": "l/min"}, outputs={"extra.inside": "degC", "extra.level": "mm"}, period=120.0,
)
def vessel(at):
    flow = at.input("extra.flow").value
    rates = {"inside": (5 - at["loss"] * (at["inside"] - 20)) / 60, "level": flow / at["area"] / 60}
    return Equations(rates, {"extra.inside": at["inside"], "extra.level": at["level"]})


@effect(acts_on="rate", summary="A vent opens.", source="of its own")
def vent(rate, size=quantity("1/s", typical=0.01, lower=0.0), edge=quantity("degC", typical=5.0, null=40.0)):
    return rate.with_rate(-size * ca.fmax(rate["inside"] - edge, 0))
'''


@dataclass(frozen=True)
class Surface(Stage):
    warmer: Expression
    loss: Expression = 0


@effect("radiation", acts_on="surface", summary="Heat is lost with the square of the excess.", source="of its own")
def radiation(surface, size=quantity("1/(rad s)", typical=1e-3, lower=0.0)):
    return replace(surface, loss=surface.loss + size * surface.warmer**2)


@effect("storing", acts_on="surface", summary="The surface has a time of its own.", source="of its own")
def storing(surface, time=quantity("s", typical=10.0, lower=0.0)):
    return replace(surface, loss=surface.loss + 1e-6 * time * surface.warmer)


@physics(
    "thermal", summary="A heated body.", source="Newton 1701",
    parameters=(
        constant("rate", "1/s", 0.02, lower=1e-5, upper=1.0),
        constant("power", "rad/(m s)", 1.0, lower=1e-3, upper=1e3),
    ),
    states=(state("body", "rad", typical=20.0, start=20.0),),
    inputs={"gripper_x": "m"}, outputs={"q.body": "rad"}, period=60.0, step=0.5,
)  # fmt: skip
def thermal(at):
    surface = at.stage("surface", Surface(at["body"]))
    rate = at["power"] * at.input("gripper_x").value - at["rate"] * at["body"] - surface.loss
    return Equations({"body": rate}, {"q.body": at["body"]})


@effect("source", acts_on="rate", summary="Something comes from elsewhere.", source="of its own")
def source(rate, size=quantity("rad/s", typical=0.1)):
    return rate.with_rate(size)


@physics(
    "chain", summary="A store that drains into a second one.", source="Lavoisier 1789",
    parameters=(constant("first", "1/s", 0.3, lower=1e-3), constant("second", "1/s", 0.2, lower=1e-3)),
    states=(state("hidden", "rad", typical=3.0), state("shown", "rad", typical=3.0)),
    inputs={"gripper_x": "m"}, outputs={"q.body": "rad"}, period=20.0,
)  # fmt: skip
def chain(at):
    flow = at["first"] * at["hidden"]
    rates = {"hidden": at.input("gripper_x").value - flow, "shown": flow - at["second"] * at["shown"]}
    return Equations(rates, {"q.body": at["shown"]})


@physics(
    "spinning", summary="A shaft of which only the speed is measured.", source="Newton 1687",
    parameters=(constant("inertia", "kg m^2", 0.02, lower=1e-4, upper=10.0),),
    states=(state("angle", "rad", typical=3.0), state("speed", "rad/s", typical=3.0)),
    inputs={"tau.motor": "N m"}, outputs={"v.shaft": "rad/s"},
)  # fmt: skip
def spinning(at):
    speed = at["speed"]
    return Equations({"angle": speed, "speed": at.input("tau.motor").value / at["inertia"]}, {"v.shaft": speed})


def pushed(seed, size=1.0):
    """A force or another input as a sum of sines."""
    rng = np.random.default_rng(seed)
    sizes, paces, phases = rng.uniform(0.3, 1.0, 3), rng.uniform(0.5, 2.0, 3), rng.uniform(0.0, 6.0, 3)
    return lambda t: size * sum(s * np.sin(p * t + f) for s, p, f in zip(sizes, paces, phases, strict=True))


def recorded(name, change, start, seconds, rate, driven, channels, noise, seed):
    """A run of what `change` says, with an input and (channel, unit, state) of what is measured."""
    time = np.arange(0.0, seconds, 1.0 / rate)
    found = solve_ivp(change, (0.0, seconds), start, "LSODA", time, rtol=1e-9, atol=1e-10, max_step=2.0 / rate).y
    rng, (column, unit, force) = np.random.default_rng(seed), driven
    measured = {c: Channel(time, found[k] + noise * rng.normal(size=len(time)), u) for c, u, k in channels}
    return Run(name, {column: Channel(time, force(time), unit), **measured})


@pytest.fixture(scope="module")
def heated():
    def run(seed):
        heat = pushed(seed, 0.2)

        def change(t, s):
            return [0.8 + heat(0.05 * t) - 0.02 * s[0] - 3e-4 * s[0] ** 2]

        driven = "gripper_x", "m", lambda t: 0.8 + heat(0.05 * t)
        shown = [("q.body", "rad", 0)]
        return recorded(f"{seed}.csv", change, [15.0 + 5 * seed], 600.0, 1.0, driven, shown, 0.05, seed)

    return [run(seed) for seed in range(3)]


@pytest.fixture(scope="module")
def oscillations():
    def run(seed):
        push = pushed(seed)

        def change(t, s):
            return [s[1], (push(t) - STIFFNESS * s[0] - DAMPING * s[1]) / (INERTIA - 0.5)]

        driven = "tau.push", "N", push
        return recorded(f"{seed}.csv", change, [0.05, 0.0], 8.0, 100.0, driven, [("q.mass", "m", 0)], 2e-4, seed)

    return [run(seed) for seed in range(2)]


@pytest.fixture
def oscillator(tmp_path):
    path = tmp_path / "oscillator.py"
    path.write_text(OSCILLATOR)
    return path


def test_what_a_state_of_first_order_lacks_is_named_and_is_no_acceleration(heated):
    found = repair(physics_model(thermal, own_effects=[radiation]), heated[:2], heated[2:])
    assert [e.name for e in found.model.effects] == ["radiation"]
    size = found.model.parameters["radiation.size"]
    assert abs(size.value - 3e-4) < 4 * size.std
    assert {(curve.unit, curve.against) for curve in found.missing_force} == {("rad/s", "body"), ("rad/s", "time")}
    assert not {"acceleration", "speed"} & set(found.sentence.split())


@pytest.mark.slow
def test_a_state_that_the_runs_cannot_tell_from_the_one_named_is_said():
    def run(seed):
        flow = pushed(seed)

        def change(t, s):
            return [flow(t) + 0.5 - 0.4 * s[0], 0.4 * s[0] - 0.15 * s[1]]

        driven, shown = ("gripper_x", "m", flow), [("q.body", "rad", 1)]
        return recorded(f"{seed}.csv", change, [1.0, 1.0 + seed], 100.0, 5.0, driven, shown, 0.02, seed)

    found = repair(physics_model(chain, own_effects=[source]), [run(1), run(2)])
    (step,) = found.path[1:]
    assert {f"{step.added[0]}:{step.joints[0]}", *step.tied_with} == {"source:hidden", "source:shown"}
    assert f"cannot distinguish {step.tied_with[0]}" in found.sentence


def test_what_a_base_allows_is_plausible_however_slow():
    model = physics_model(thermal).with_effect(storing).with_values({"storing.time": 600.0})
    assert implausible_values(model) == []


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_values_half_off_end_at_the_truth(oscillator, oscillations, factor):
    # At 0.5 nothing has an inertia: the equations divide by zero where the user's values begin.
    truth = {"stiffness": STIFFNESS, "damping": DAMPING, "inertia": INERTIA}
    model = load_base(oscillator).with_values({name: factor * value for name, value in truth.items()})
    found = compare(model, oscillations)
    assert found.verdict is Verdict.EXPLAINED
    assert all(abs(found.parameters[n].value - value) < 4 * found.parameters[n].std for n, value in truth.items())


def test_a_state_that_nothing_shows_stays_where_it_begins():
    torque = pushed(1, 0.1)
    driven, shown = ("tau.motor", "N m", torque), [("v.shaft", "rad/s", 1)]
    run = recorded("a.csv", lambda t, s: [s[1], torque(t) / 0.02], [0.0, 1.0], 8.0, 100.0, driven, shown, 0.01, 1)
    found = compare(physics_model(spinning).with_values({"inertia": 0.03}), [run])
    assert abs(found.parameters["inertia"].value - 0.02) < 4 * found.parameters["inertia"].std
    assert found.parameters["initial_angle"].value == 0.0


def test_a_base_keeps_its_own_units_in_effects_and_laws(tmp_path):
    path, time = tmp_path / "vessel.py", np.arange(0.0, 600.0, 2.0)
    path.write_text(VESSEL)
    found = solve_ivp(lambda t, s: [(5 - 0.2 * (s[0] - 20)) / 60, (1 + np.sin(t / 30)) / 180], (0, 600), [25.0, 10.0],
                      t_eval=time, rtol=1e-8).y  # fmt: skip
    noise = np.random.default_rng(1).normal(size=found.shape) * [[0.1], [0.01]]
    columns = {"time [s]": time, "extra.flow [l/min]": 1 + np.sin(time / 30),
               "extra.inside [degC]": found[0] + noise[0], "extra.level [mm]": found[1] + noise[1]}  # fmt: skip
    table = np.array([*columns.values()]).T
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header=",".join(columns), comments="")
    model = load_base(path)
    assert model.own_effects[0].quantities["edge"].unit == "degC"
    study = CheckedStudy.of(model, [tmp_path / "a.csv"]).study
    units = {
        (t.kind, *(v.name for v in t.variables), t.location.joint): t for t in physics_formula_candidates(study.first())
    }
    edge = units["threshold above", "inside", "level"]
    assert (edge.parameters["place"].unit, edge.size_parameter.unit) == ("degC", "mm/(s K)")
    assert units["proportion", "level", "inside"].size_parameter.unit == "K/(s mm)"


def test_a_fit_that_is_worse_than_the_signal_is_lost_and_names_no_physics(
    tmp_path, oscillator, oscillations, complains
):
    runs = [tmp_path / "run.csv"]
    write_run_csv(oscillations[0], *runs)
    model, output = tmp_path / "m.toml", tmp_path / "repaired.toml"
    assert called("new", "--base", oscillator, model, "--set", "inertia=0.5 kg +/- 1 ug")[0] == 0
    for command in (("compare",), ("diagnose",), ("repair", "--output", output)):
        answer = tmp_path / f"{command[0]}.json"
        assert called(command[0], model, *runs, *command[1:], "--json", answer, "--report", tmp_path / "r.html")[0] == 1
        found = json.loads(answer.read_text())
        assert found["verdict"] == "lost"
        assert found["sentence"].startswith("lost: give start values or a prior for ")
        assert not any(found.get(what) for what in ("effects", "candidates", "missing_force"))
    assert not output.exists()
    with complains(TaskFailedError):
        fit(model, runs)
