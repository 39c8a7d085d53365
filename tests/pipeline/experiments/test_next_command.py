"""`armdyn next` as a user meets it; the recordings come from equations of their own."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
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
