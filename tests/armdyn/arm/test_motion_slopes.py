"""Derivatives of simulated motion against difference quotients of simulations."""

from dataclasses import replace

import numpy as np
import pytest

from armdyn.arm.closed_loop.motion_slopes import interpolate_rows, motion_slopes
from armdyn.arm.closed_loop.simulator import DriveInputs, simulate_arm
from armdyn.arm.control_laws import CONTROL_LAWS
from armdyn.effects.catalogue import find

from . import urdfs
from .conftest import with_effects

STEP, SECONDS = 1e-3, 6.0
SMOOTH = {
    "joint_viscous_friction__coefficient": 0.4, "rotor_inertia__inertia": 0.03, "torque_offset__torque": 0.1,
    "servo_integral__rate": 0.3,
}  # fmt: skip
DRY = {"joint_coulomb_friction__torque": 0.2, "joint_load_friction__coefficient": 0.05}
SHARE = {"smooth": 0.01, "dry": 0.2}  # of its size by which a derivative may differ: steps of friction are not smooth


@pytest.fixture(scope="module", params=SHARE)
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def model(kind, tmp_path_factory):
    arm = urdfs.arm(tmp_path_factory.mktemp("arm"), urdfs.DOUBLE)
    drives = {"servo": {"joints": ["swing", "elbow"], "gain": "25 N m/rad"}}
    payload = find(f"payload:{arm.joints[-1]}")
    return with_effects(arm.with_drives(drives), **SMOOTH, **(DRY if kind == "dry" else {})).with_effect(payload)


@pytest.fixture(scope="module")
def drives():
    time = np.arange(0.0, SECONDS, STEP)
    given = DriveInputs.off(len(time), [CONTROL_LAWS["position"]] * 2)
    told = given.signals
    told.share[:], told.gain[:], told.damping[:] = 1.0, 25.0, 0.5
    told.command[:] = np.column_stack([0.6 * np.sin(2.0 * time) + 0.4, 0.5 * np.sin(3.1 * time + 1.0) - 0.4])
    told.command[time > 4.5] = told.command[np.searchsorted(time, 4.5)]  # it stops, and sticks
    told.limit[:] = 6.0  # reached now and then
    return given


START = np.array([0.5, 0.05]), np.array([0.3, -0.2])


def moved(model, theta, drives, start=START):
    return simulate_arm(model, theta, start, drives, STEP)


def whole_slopes(*given):
    """(n + 1, nj, ...) derivatives over a whole motion."""
    parts = [states.copy() for _, states in motion_slopes(*given)]
    return np.concatenate([parts[0][:1], *(states[1:] for states in parts)])


def close(found, quotient, share):
    """Whether a derivative is a difference quotient up to a share of its size."""
    return np.sqrt(np.mean((found - quotient) ** 2)) <= share * np.sqrt(np.mean(quotient**2)) + 1e-9


def test_slopes_by_every_parameter_are_difference_quotients(model, drives, kind):
    theta = model.theta()
    slopes = whole_slopes(model, theta, moved(model, theta, drives), drives, (), STEP)
    for i, (name, p) in enumerate(model.parameters.items()):
        size = 1e-3 * p.typical
        ends = []
        for sign in (1.0, -1.0):
            changed = theta.copy()
            changed[i] += sign * size
            ends.append(moved(model, changed, drives)[0])
        assert close(slopes[:, :, i], (ends[0] - ends[1]) / (2.0 * size), SHARE[kind]), name


def test_slopes_by_inputs_and_start_are_difference_quotients(model, drives, kind):
    theta = model.theta()
    motion = moved(model, theta, drives)
    changes = {"gain": 1e-2, "command": 1e-4, "damping": 1e-3, "limit": 1e-3}
    told = drives.signals
    others = [
        replace(drives, signals=replace(told, **{name: getattr(told, name) + size})) for name, size in changes.items()
    ]
    slopes = whole_slopes(model, theta, motion, drives, others, STEP)
    count = len(theta)
    for i, other in enumerate(others):
        assert close(slopes[:, :, count + i], moved(model, theta, other)[0] - motion[0], SHARE[kind]), i
    for k in range(4):
        start = [START[0].copy(), START[1].copy()]
        start[k // 2][k % 2] += 1e-5
        quotient = (moved(model, theta, drives, tuple(start))[0] - motion[0]) / 1e-5
        assert close(slopes[:, :, count + len(others) + k], quotient, SHARE[kind]), k


def test_rows_are_interpolated_within_their_ends():
    values = np.arange(4.0)[:, None] * [1.0, 10.0]
    found = interpolate_rows(values, np.arange(4.0), np.array([-1.0, 0.5, 2.0, 9.0]))
    np.testing.assert_allclose(found, [[0.0, 0.0], [0.5, 5.0], [2.0, 20.0], [3.0, 30.0]])
