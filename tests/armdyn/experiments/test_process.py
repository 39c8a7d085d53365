"""Experiments with a base of one's own; the recordings come from scipy, which shares no code with the models."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from armdyn.effects.effect import effect
from armdyn.errors import InputError, UnknownNameError
from armdyn.experiments.plan import plan_process_experiment
from armdyn.experiments.process import input_ranges, process_experiments
from armdyn.experiments.rivals import rivals_by_name
from armdyn.identify.compare import compare
from armdyn.identify.diagnose import diagnose
from armdyn.identify.studies import make_study
from armdyn.parameter import quantity
from armdyn.physics import Equations, Expression, Moment, Rate, Stage, constant, physics, state
from armdyn.physics.model import physics_model
from armdyn.run import Channel, Run

NOISE = 0.1


@dataclass(frozen=True)
class Blade(Stage):
    """Torque on a fan's shaft over its inertia, rad/s^2."""

    speed: Expression
    slowing: Expression


@physics(
    "fan",
    summary="A fan with a motor.",
    source="Newton",
    parameters=(constant("gain", "rad/s^2/V", 4.0, lower=0.1), constant("drag", "1/s", 0.5, lower=0.0)),
    states=(state("speed", "rad/s", typical=10.0, start=0.0),),
    inputs={"extra.voltage": "V"},
    outputs={"extra.turning": "rad/s"},
    held=("extra.voltage",),
    period=3.0,
)
def fan(at: Moment) -> Equations:
    """The motor drives, the air brakes."""
    blade = at.stage("blade", Blade(at["speed"], slowing=at["drag"] * at["speed"]))
    rate = at["gain"] * at.input("extra.voltage").value - blade.slowing
    return Equations({"speed": rate}, {"extra.turning": at["speed"]})


@physics(
    "cup",
    summary="A cup cools.",
    source="Newton",
    parameters=(constant("loss", "1/s", 0.004, lower=0.0),),
    states=(state("excess", "K", typical=50.0, start=50.0),),
    outputs={"extra.excess": "K"},
    period=200.0,
)
def cup(at: Moment) -> Equations:
    """In proportion to the excess over the room's temperature."""
    return Equations({"excess": -at["loss"] * at["excess"]}, {"extra.excess": at["excess"]})


@effect(acts_on="rate", summary="The loss grows with the square of the excess.", source="of its own")
def by_square(rate: Rate, size: Expression = quantity("1/s/K", typical=2e-5, lower=0.0)) -> Rate:
    """-size * excess^2."""
    return rate.with_rate(-size * rate[rate.state] ** 2)


@effect(summary="Drag grows with the square of the speed.", source="of its own")
def square_drag(blade: Blade, size: Expression = quantity("1/rad", typical=0.02, lower=0.0)) -> Blade:
    """size * speed * |speed|."""
    return replace(blade, slowing=blade.slowing + size * blade.speed * ca.fabs(blade.speed))


@effect(summary="Bearings have dry friction.", source="of its own")
def dry_friction(blade: Blade, size: Expression = quantity("rad/s^2", typical=0.5, lower=0.0)) -> Blade:
    """size * sign(speed), smooth near standstill."""
    return replace(blade, slowing=blade.slowing + size * ca.tanh(blade.speed / 0.1))


def recorded(name: str, voltage: np.ndarray, truth: str, seed: int, start: float = 0.0) -> Run:
    """The turning fan by scipy, with one of two laws; the voltage is held for .02 s."""
    time = 0.02 * np.arange(len(voltage))
    size = {"square": 0.02, "dry": 0.5}[truth]

    def rate(volts: float, w: float) -> float:
        law = size * w * abs(w) if truth == "square" else size * np.tanh(w / 0.1)
        return 4.0 * volts - 0.5 * w - law

    speed = [start]
    for volts in voltage[:-1]:
        found = solve_ivp(lambda _, w, u=volts: [rate(u, w[0])], (0.0, 0.02), [speed[-1]], rtol=1e-9, atol=1e-10)
        speed.append(float(found.y[0, -1]))
    turning = np.array(speed) + NOISE * np.random.default_rng(seed).standard_normal(len(time))
    channels = {"extra.voltage": Channel(time, voltage, "V"), "extra.turning": Channel(time, turning, "rad/s")}
    return Run(name, channels, base_channels=frozenset(channels))


def a_small_step(truth: str) -> Run:
    voltage = np.where(np.arange(300) < 150, 1.0, 1.1)
    return recorded("first.csv", voltage, truth, 3, start=6.4)


def study_of(runs: list[Run]):
    return make_study(physics_model(fan), runs, [], [square_drag, dry_friction])


@pytest.fixture(scope="module")
def rivals():
    return rivals_by_name(study_of([a_small_step("square")]), ["square_drag", "dry_friction"])


@pytest.fixture(scope="module")
def plan(rivals):
    ranges = input_ranges([rivals.last], ["extra.voltage"], {"extra.voltage": (0.0, 6.0)})
    return plan_process_experiment(rivals, process_experiments(rivals, ranges))


def test_signals_keep_to_the_range_of_their_input_and_to_states_within_bounds(rivals, plan):
    kinds = {p.experiment.kind for p in plan.proposals}
    assert {"step", "small_step", "steps", "chirp", "longer"} == kinds
    for one in plan.proposals:
        volts = one.experiment.recording.channels["extra.voltage"].value
        assert volts.min() >= 0.0
        assert volts.max() <= 6.0
    seen = input_ranges([rivals.last], ["extra.voltage"], {})
    assert seen == {"extra.voltage": (1.0, 1.1)}


def test_a_range_that_the_process_has_not_seen_separates_what_its_own_does_not(rivals, plan):
    near = process_experiments(rivals, input_ranges([rivals.last], ["extra.voltage"], {}))
    wide, narrow = (rises(rivals, one) for one in (plan, plan_process_experiment(rivals, near)))
    assert wide["longer"] == pytest.approx(narrow["longer"])  # the inputs of the last recording
    assert all(wide[kind] > 100.0 * narrow[kind] for kind in ("step", "steps", "chirp"))
    assert narrow["step"] > narrow["small_step"]
    assert plan.proposals[0].experiment.kind != "longer"


def rises(rivals, plan):
    """By kind, the rise of chi2 if the drag is true and dry friction is refitted."""
    true = [h.name for h in rivals.hypotheses].index("square_drag")
    return {p.experiment.kind: p.expected.chi2_increase[true, 1 - true] for p in plan.proposals}


def test_a_process_without_inputs_is_started_elsewhere_or_recorded_longer():
    """A cooling cup: what it loses by radiation grows faster with its temperature than what the air takes."""
    time = np.arange(0.0, 600.0, 5.0)
    warm = solve_ivp(lambda _, w: -0.004 * w - 2e-5 * w**2, (0.0, 600.0), [60.0], t_eval=time, rtol=1e-9).y[0]
    noisy = warm + 0.05 * np.random.default_rng(2).standard_normal(len(time))
    run = Run("cup.csv", {"extra.excess": Channel(time, noisy, "K")}, base_channels=frozenset({"extra.excess"}))
    found = rivals_by_name(make_study(physics_model(cup), [run], [], [by_square]), ["by_square"])
    plan = plan_process_experiment(found, process_experiments(found, {}))
    told = {p.experiment.kind: p for p in plan.proposals}
    assert {"longer", "larger", "smaller"} == set(told)
    assert told["larger"].expected.separation > 1.5 * told["smaller"].expected.separation
    start = told["larger"].experiment.begins["initial_excess"][0]
    assert 100.0 < start < 120.0  # twice as far from where it comes to


@pytest.mark.parametrize("truth", ["square", "dry"])
def test_what_the_proposed_signal_promises_is_kept_by_a_recording_of_scipy(truth):
    name = {"square": "square_drag", "dry": "dry_friction"}[truth]
    first = a_small_step(truth)
    rivals = rivals_by_name(study_of([first]), ["square_drag", "dry_friction"])
    ranges = input_ranges([first], ["extra.voltage"], {"extra.voltage": (0.0, 6.0)})
    best = plan_process_experiment(rivals, process_experiments(rivals, ranges)).proposals[0]
    volts = best.experiment.recording.channels["extra.voltage"].value
    second = recorded("second.csv", volts, truth, 4, start=6.4)
    study = study_of([first, second])
    found = diagnose(study)
    assert [c.effect for step in found.search.steps[1:] for c in step.added] == [name]
    names = [h.name for h in rivals.hypotheses]
    promised = best.expected.chi2_increase[names.index(name), 1 - names.index(name)]
    effects = [square_drag, dry_friction] if name == "square_drag" else [dry_friction, square_drag]
    right, wrong = (compare(make_study(physics_model(fan, [e]), [first, second], [], [])).fit.cost for e in effects)
    assert 0.5 < np.sqrt((wrong - right) / promised) < 2.0


def test_wrong_inputs_are_refused(rivals, complains):
    with complains(UnknownNameError):
        input_ranges([rivals.last], ["extra.voltage"], {"extra.volts": (0.0, 1.0)})
    with complains(InputError):
        input_ranges([rivals.last], ["extra.voltage"], {"extra.voltage": (2.0, 1.0)})
