"""`armdyn next` as a user meets it; the recordings come from equations of their own."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from worlds.pendulum import Setup, record, weighed

from armdyn.recording.units import KnownQuantity
from armdyn.run import write_run_csv


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A model, and a run for each hidden effect."""
    folder = tmp_path_factory.mktemp("next")
    (folder / "model.toml").write_text(
        'base = "pendulum"\n[parameters]\nlength = { value = 0.36, unit = "m" }\nmass = { value = 0.08, unit = "kg" }\n'
    )
    for name, size in (("wind", 0.01), ("pivot_viscous_friction", 1e-3), ("cross_axis_sensitivity", 0.05)):
        setup = Setup(hidden={name: size}, duration=8.0, force_noise=5e-3)
        run = record("a.csv", setup, np.random.default_rng(5))
        run = weighed(run, KnownQuantity(0.08, 0.0008, "kg"), KnownQuantity(0.368, 0.003, "m"))
        write_run_csv(replace(run, noise={"load_force": 5e-3}), folder / f"{name}.csv")
    return folder


def answer(armdyn, *arguments):
    status, out, err = armdyn("next", *arguments, "--json", "-")
    assert status in (0, None), err
    return json.loads(out)


def test_limits_of_ones_own_rig_are_kept_and_no_other_robot_is_asked(armdyn, files):
    """0.3 m to the side is more than Baxter's line has on that side, and 1 m/s^2 less than it may."""
    limits = ("--travel", 0.3, "--speed", 0.5, "--acceleration", 1.0, "--swing", 0.4)
    status, out, _ = armdyn(
        "next", files / "model.toml", files / "pivot_viscous_friction.csv", "--rivals",
        "pivot_viscous_friction,linear_drag", "--seconds", 5, "--out", "own.csv", *limits,
    )  # fmt: skip
    assert status in (0, None)
    assert "motion own.csv" in out
    assert "armdyn check" not in out
    motion = np.genfromtxt("own.csv", delimiter=",", skip_header=1)
    assert np.all(np.abs(motion[:, 1:]).max(axis=0) <= [0.3, 0.5, 1.0])
    assert np.abs(motion[:, 3]).max() > 0.5


def test_wind_and_tilt_cannot_be_told_apart_by_a_motion_but_by_turning_the_robot(armdyn, files):
    found = answer(armdyn, files / "model.toml", files / "wind.csv", "--seconds", 4, "--output", "motion.csv")
    assert found["verdict"] == "cannot_tell_apart"
    assert [set(pair["effects"]) for pair in found["inseparable"]] == [{"wind", "path_tilt"}]
    assert "rotation" in found["inseparable"][0]["why"]
    assert found["experiments"][0]["kind"] == "turn"
    assert found["experiments"][0]["probability"] > 0.9
    assert next(e for e in found["experiments"] if e["kind"] == "motion")["output"] is None
    assert not Path("motion.csv").exists()  # a motion that tells nothing is not offered


def test_where_one_verdict_stands_nothing_is_designed(armdyn, files):
    found = answer(armdyn, files / "model.toml", files / "cross_axis_sensitivity.csv")
    assert found["verdict"] == "effect_missing"
    assert found["rivals"] == [] or all("=" in name for name in found["rivals"])


FAN = '''
"""A fan on a motor."""
import casadi as ca
from armdyn.effects.effect import effect
from armdyn.parameter import quantity
from armdyn.physics import Equations, Expression, Moment, Rate, constant, physics, state

@physics("fan", summary="A fan.", source="Newton",
    parameters=(constant("gain", "rad/s^2/V", 4.0, lower=0.1), constant("drag", "1/s", 0.5, lower=0.0)),
    states=(state("speed", "rad/s", typical=10.0, start=0.0),),
    inputs={"extra.voltage": "V"}, outputs={"extra.turning": "rad/s"}, held=("extra.voltage",), period=3.0)
def fan(at: Moment) -> Equations:
    """The motor drives, the air brakes."""
    return Equations({"speed": at["gain"] * at.input("extra.voltage").value - at["drag"] * at["speed"]},
                     {"extra.turning": at["speed"]})

@effect(acts_on="rate", summary="Drag by the square.", source="of its own")
def square_drag(rate: Rate, size: Expression = quantity("1/rad", typical=0.02, lower=0.0)) -> Rate:
    """size w |w|."""
    return rate.with_rate(-size * rate["speed"] * ca.fabs(rate["speed"]))
'''


@pytest.fixture
def fan(armdyn):
    """A base of one's own in the present folder, with a recording by scipy."""
    Path("fan.py").write_text(FAN)
    assert armdyn("new", "--base", "fan.py", "fan.toml")[0] in (0, None)
    time = 0.02 * np.arange(300)
    voltage = np.where(time < 3.0, 1.0, 1.1)
    level = solve_ivp(lambda t, w: 4.0 * (1.0 if t < 3.0 else 1.1) - 0.5 * w, (0.0, 6.0), [8.0], t_eval=time, rtol=1e-8)
    rows = np.column_stack([time, voltage, level.y[0] + 0.1 * np.random.default_rng(1).standard_normal(300)])
    head = "time [s],extra.voltage [V],extra.turning [rad/s]"
    np.savetxt("run.csv", rows, delimiter=",", header=head, comments="")


@pytest.mark.usefixtures("fan")
def test_for_a_base_of_ones_own_a_signal_within_the_given_range_is_proposed_and_written(armdyn):
    found = answer(
        armdyn, "fan.toml", "run.csv", "--rivals", "square_drag", "--input", "extra.voltage=0:6", "--output", "v.csv"
    )
    assert set(found["rivals"]) == {"square_drag on speed", "nothing"}
    best = found["experiments"][0]
    assert best["kind"] in ("step", "small_step", "steps", "chirp", "longer")
    assert best["output"] == "v.csv"
    written = np.genfromtxt("v.csv", delimiter=",", names=True)
    assert written.dtype.names[0].startswith("time")
    volts = written[written.dtype.names[1]]
    assert 0.0 <= volts.min() < volts.max() <= 6.0
    status, *_ = armdyn("next", "fan.toml", "run.csv", "--rivals", "square_drag", "--report", "next.html")
    assert status in (0, None)
    assert "extra.voltage from 1 to 1.1 V" in Path("next.html").read_text()


@pytest.mark.parametrize("wrong", ["extra.voltage", "extra.voltage=1:nan", "extra.volts=0:1", "extra.voltage=2:1"])
@pytest.mark.usefixtures("fan")
def test_a_wrong_range_of_an_input_is_refused_in_one_line(armdyn, wrong):
    status, _, err = armdyn("next", "fan.toml", "run.csv", "--rivals", "square_drag", "--input", wrong)
    assert status == 2
    assert wrong.partition("=")[0] in err
    assert len(err.strip().splitlines()) == 1
