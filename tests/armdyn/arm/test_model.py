import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from worlds.baxter import JOINTS, OUTSIDE, generate, motion

from armdyn.arm.prepared import COMPARED_SHARE_OF_DRIVE_CUTOFF
from armdyn.effects.catalogue import find
from armdyn.effects.effect import effect
from armdyn.errors import InputError, UnknownNameError
from armdyn.parameter import quantity
from armdyn.pendulum.model import pendulum_model
from armdyn.run import Channel

from . import urdfs
from .conftest import chi2_per_sample, fitted, residuals


def test_a_sliding_joint_has_units_of_its_own(tmp_path):
    model = urdfs.arm(tmp_path, urdfs.SLIDE)
    for name in ("joint_viscous_friction", "rotor_inertia", "joint_coulomb_friction", "joint_stribeck_friction"):
        model = model.with_effect(find(name))
    units = {name: p.unit for name, p in model.parameters.items()}
    assert units == {
        "joint_viscous_friction.coefficient[slide]": "N s/m",
        "rotor_inertia.inertia[slide]": "kg",
        "joint_coulomb_friction.torque[slide]": "N",
        "joint_stribeck_friction.torque[slide]": "N",
        "joint_stribeck_friction.speed[slide]": "m/s",
    }


def test_a_slide_is_identified(tmp_path):
    run = urdfs.recorded(["slide"], ["m"], lambda v, a, **_: 5.0 * a + 30.0 * v + 4.0 * np.sign(v) - 1.0)
    model = urdfs.arm(tmp_path, urdfs.SLIDE)
    for name in ("rotor_inertia", "joint_viscous_friction", "joint_coulomb_friction", "torque_offset"):
        model = model.with_effect(find(name))
    found, _ = fitted(model, [model.prepare_run(run)])
    assert list(found.theta()) == pytest.approx([3.0, 30.0, 4.0, -1.0], rel=2e-3)  # the URDF has 2 kg of the 5


def test_sliding_and_continuous_joints_go_together(tmp_path):
    g, m, r = 9.81, 2.0, 0.1

    def torque(q, v, a):
        # A lift that carries an arm on a horizontal axis: by Lagrange, z_com = z - r sin(turn).
        lift = 2 * m * (a[:, 0] + g) - m * r * (a[:, 1] * np.cos(q[:, 1]) - v[:, 1] ** 2 * np.sin(q[:, 1]))
        turn = (m * r**2 + 0.02) * a[:, 1] - m * r * np.cos(q[:, 1]) * (a[:, 0] + g)
        return np.column_stack([lift, turn])

    model = urdfs.arm(tmp_path, urdfs.MIXED)
    run = urdfs.recorded(["lift", "turn"], ["m", "rad"], torque)
    inside = slice(50, -50)
    for name, residual in residuals(model, run).items():
        assert np.abs(residual[inside]).max() < 6e-3, name


def test_locked_joints_stay_at_zero(tmp_path):
    elbow = urdfs.arm(tmp_path, urdfs.DOUBLE, joints=["elbow"])
    assert elbow.joints == ("elbow",)
    run = urdfs.recorded(["elbow"], ["rad"], lambda q, a, **_: 0.04 * a - 2.0 * 9.81 * 0.1 * np.cos(q))
    assert np.abs(residuals(elbow, run)["tau.elbow"][50:-50]).max() < 6e-3


def test_effects_on_some_joints_are_extended_and_removed_joint_by_joint(baxter, complains):
    model = baxter.with_effect(find("joint_viscous_friction:right_s1,right_w0"))
    assert model.effects[0].label == "joint_viscous_friction:right_s1,right_w0"
    assert tuple(model.parameter_names_by_joint("joint_viscous_friction")) == ("right_s1", "right_w0")
    assert model.can_add_effect(find("joint_viscous_friction"))
    assert not model.can_add_effect(find("joint_viscous_friction:right_s1"))
    whole = model.with_effect(find("joint_viscous_friction"))
    assert whole.effects[0].label == "joint_viscous_friction"
    assert len(whole.names) == 7
    less = whole.without_effect("joint_viscous_friction:right_s0")
    assert "joint_viscous_friction.coefficient[right_s0]" not in less.names
    assert len(less.names) == 6
    assert less.without_effect("joint_viscous_friction").effects == ()
    with complains(UnknownNameError):
        less.without_effect("payload")


def test_only_the_named_joints_feel_an_effect(baxter):
    run = generate(None, 1.0, 0, duration=3.0)
    model = baxter.with_effect(find("torque_offset:right_e1")).with_values({"torque_offset.torque[right_e1]": 2.0})
    before, after = (m.predict(run, m.theta()) for m in (baxter, model))
    for channel, rows in before.slices.items():
        change = after.values[rows] - before.values[rows]
        assert change == pytest.approx(np.full(len(change), 2.0 if channel == "tau.right_e1" else 0.0))


@pytest.mark.parametrize(
    "name",
    [
        "joint_viscous_friction:right_s9",
        "payload:right_s0",
        "joint_coupling:right_s0",
        "sensor_bias",
        "torque_offset",
    ],
)
def test_effects_that_do_not_fit_are_refused(baxter, name, complains):
    model = baxter.with_effect(find("torque_offset"))
    with complains(InputError):
        model.with_effect(find(name))


@pytest.mark.parametrize(
    "effect",
    [
        "joint_viscous_friction",
        "linear_drag:right_s0",
    ],
)
def test_a_pendulum_has_no_joints(effect, complains):
    with complains(InputError):
        pendulum_model(0.4, 0.1).with_effect(find(effect))


def test_typical_sizes_grow_with_the_effort_of_the_joint(baxter):
    model = baxter.with_effect(find("joint_coulomb_friction"))
    shoulder, wrist = (
        model.parameters[f"joint_coulomb_friction.torque[{j}]"].typical for j in ("right_s0", "right_w0")
    )
    assert shoulder / wrist == pytest.approx(50.0 / 15.0)


def test_a_users_own_effect_takes_ten_lines(baxter):
    import casadi as ca

    @effect("cogging", acts_on="joint", summary="The motor's teeth pull.", source="a data sheet")
    def cogging(
        joint,
        sine=quantity("N m", typical=0.5),
        cosine=quantity("N m", typical=0.5),
    ):
        angle = 14 * joint.position
        return joint.with_torque(sine * ca.sin(angle) + cosine * ca.cos(angle))

    assert "cogging" in OUTSIDE
    runs = [baxter.prepare_run(generate("cogging", 1.0, 3, recording=k)) for k in range(2)]
    found, _ = fitted(baxter.with_effect(cogging), runs)
    assert chi2_per_sample(found, runs[1]) < 0.05 * chi2_per_sample(baxter, runs[1])
    amplitude = np.hypot(found.value("cogging.sine[right_s0]"), found.value("cogging.cosine[right_s0]"))
    assert amplitude == pytest.approx(0.8, rel=0.1)


def test_an_effect_whose_gain_changes_with_the_motion_is_refused(baxter, complains):
    @effect("odd", acts_on="joint", summary="", source="")
    def odd(joint, share=quantity("1", typical=0.1)):
        return joint.with_gain(1 + share * joint.position)

    model = baxter.with_effect(odd)
    with complains(InputError):
        model.predict(generate(None, 1.0, 0, duration=2.0), model.theta())


def without(run, *names):
    return replace(run, channels={name: c for name, c in run.channels.items() if name not in names})


def with_torque(change):
    """A run with a changed torque of the first joint: a function of times and values."""

    def changed(run):
        c = run.channels["tau.right_s0"]
        return replace(run, channels={**run.channels, "tau.right_s0": Channel(*change(c.time, c.value), c.unit)})

    return changed


@pytest.mark.parametrize(
    "change",
    [
        lambda run: without(run, "q.right_e0"),
        lambda run: without(run, *(f"tau.{j}" for j in JOINTS)),
        with_torque(lambda t, tau: (t, np.ones(len(tau)))),
        with_torque(lambda t, tau: (t[:12], tau[:12])),
        with_torque(lambda t, tau: (t, np.where(np.arange(len(t)) < 3, tau, 1.0))),
        with_torque(lambda t, tau: (t + 100.0, tau)),
    ],
)
def test_runs_that_cannot_be_compared_are_refused(baxter, change, complains):
    with complains(InputError):
        baxter.prepare_run(change(generate(None, 1.0, 0, duration=2.0)))


def test_a_position_in_the_wrong_unit_is_refused(tmp_path, complains):
    run = urdfs.recorded(["slide"], ["rad"], lambda a, **_: a)
    with complains(InputError):
        urdfs.arm(tmp_path, urdfs.SLIDE).prepare_run(run)


def test_a_missing_torque_channel_leaves_the_others(baxter):
    run = without(generate(None, 1.0, 0, duration=3.0), "tau.right_e0")
    assert baxter.predicted_channels(run) == tuple(f"tau.{j}" for j in JOINTS if j != "right_e0")
    assert len(baxter.predict(run, baxter.theta()).channels) == 6


# Preparation


@pytest.mark.parametrize(
    "recorded", [{"stated": False}, {}, {"seed": 2}, {"rate": 12.0}, {"rate": 30.0}, {"rate": 250.0}]
)
def test_the_true_model_leaves_the_noise_that_the_prepared_run_states(baxter, recorded):
    run = baxter.prepare_run(generate(None, 1.0, **{"seed": 1, **recorded}))
    samples = sum(len(run.channels[c]) for c in baxter.predicted_channels(run))
    assert chi2_per_sample(baxter, run) == pytest.approx(1.0, abs=4 * np.sqrt(2 / samples))


def test_what_was_done_to_a_torque_is_told(baxter):
    raw = generate(None, 1.0, 0, rate=250.0)
    ready = baxter.prepare_run(raw)
    done = ready.preparations["tau.right_s0"]
    assert done.cutoff == pytest.approx(10.0)
    assert (done.recorded, done.recorded_rate) == (len(raw.channels["tau.right_s0"]), pytest.approx(250.0))
    assert (done.samples, done.rate) == (len(ready.channels["tau.right_s0"]), pytest.approx(17.92))
    assert 0.0 < done.left_out < 0.01


def low_passed(run, cutoff):
    """The run with its torques smoothed by a Gaussian, their noise not stated."""
    deviation = np.sqrt(np.log(2.0) / 2.0) / (np.pi * cutoff)  # s; half the amplitude is left at the cut-off
    channels = dict(run.channels)
    for name, c in run.channels.items():
        if name.startswith("tau."):
            interval = (c.time[-1] - c.time[0]) / (len(c) - 1)
            channels[name] = Channel(c.time, gaussian_filter1d(c.value, deviation / interval), c.unit)
    return replace(run, channels=channels, noise={})


@pytest.mark.parametrize("cutoff", [3.0, 10.0])
def test_a_torque_that_was_smoothed_before_it_was_stored_is_compared(baxter, cutoff):
    model = baxter.with_effect(find("joint_viscous_friction"))
    run = model.prepare_run(low_passed(generate("joint_viscous_friction", 1.0, 0), cutoff))
    for name, done in run.preparations.items():
        assert done.cutoff >= min(
            cutoff, 10.0 if done.smoothed is None else COMPARED_SHARE_OF_DRIVE_CUTOFF * done.smoothed
        ), name
    found, _ = fitted(model, [run])
    assert found.value("joint_viscous_friction.coefficient[right_s0]") == pytest.approx(2.0, rel=0.02)


def test_what_noisy_positions_bring_in_is_counted_as_noise(baxter):
    run = generate(None, 1.0, 0)
    rng = np.random.default_rng(0)
    shaken = {
        f"q.{j}": Channel(c.time, c.value + 0.02 * rng.standard_normal(len(c)), c.unit)
        for j in JOINTS
        for c in [run.channels[f"q.{j}"]]
    }
    quiet, noisy = (baxter.prepare_run(r) for r in (run, replace(run, channels={**run.channels, **shaken})))
    assert noisy.preparations["tau.right_s1"].position_cutoff < quiet.preparations["tau.right_s1"].position_cutoff
    assert noisy.noise["tau.right_s1"] > 3.0 * quiet.noise["tau.right_s1"]
    samples = sum(len(noisy.channels[c]) for c in baxter.predicted_channels(noisy))
    assert chi2_per_sample(baxter, noisy) == pytest.approx(1.0, abs=10 * np.sqrt(2 / samples))


def test_uneven_stamps_and_a_gap_change_little(baxter):
    model = baxter.with_effect(find("joint_viscous_friction"))
    run = generate("joint_viscous_friction", 1.0, 4, jitter=0.6)
    time = run.channels["q.right_s0"].time
    kept = (time < 5.0) | (time > 5.4)
    gappy = replace(run, channels={n: Channel(c.time[kept], c.value[kept], c.unit) for n, c in run.channels.items()})
    ready = model.prepare_run(gappy)
    found, _ = fitted(model, [ready])
    assert found.value("joint_viscous_friction.coefficient[right_s0]") == pytest.approx(2.0, rel=0.01)
    assert chi2_per_sample(found, ready) < 1.6


def test_recorded_velocities_improve_the_smoothed_ones(baxter):
    errors = []
    for rates in (True, False):
        run = baxter.prepare_run(generate(None, 1.0, 6, rates=rates))
        v = run.channels["v.right_s0"]
        inside = (v.time > 1.0) & (v.time < 14.0)
        errors.append(np.std((v.value - motion(6).at(v.time)[1][:, 0])[inside]))
    assert errors[0] < errors[1] < 2e-3


def test_preparing_twice_is_preparing_once(baxter):
    run = generate(None, 1.0, 0, duration=3.0)
    once = baxter.prepare_run(run)
    assert baxter.prepare_run(once) is once
    assert baxter.prepare_run(run) is once


def test_a_renamed_or_copied_prepared_run_is_predicted_alike(baxter):
    run = baxter.prepare_run(generate(None, 1.0, 0, duration=3.0))
    expected = baxter.predict(run, baxter.theta()).values
    for other in (replace(run, name="other"), pickle.loads(pickle.dumps(run))):
        assert np.array_equal(baxter.predict(other, baxter.theta()).values, expected)


def test_part_of_a_prepared_run_is_predicted_as_in_the_whole(baxter):
    run = baxter.prepare_run(generate(None, 1.0, 0, duration=4.0))
    whole = baxter.predict(run, baxter.theta())
    cut = {n: Channel(c.time[5:15], c.value[5:15], c.unit) for n, c in run.channels.items() if n.startswith("tau.")}
    part = baxter.predict(replace(run, channels={**run.channels, **cut}), baxter.theta())
    for name in part.channels:
        assert part.values[part.slices[name]] == pytest.approx(whole.values[whole.slices[name]][5:15])
