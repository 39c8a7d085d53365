"""What an inspection finds in a wrench: its sign, its axes, a sensor that was zeroed on the way, one that saturates."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from armdyn.inspection.inspect import inspect_runs
from tests.worlds.tools import AXES, SENSOR, drawn, measured, recorded, robot, sensed_model

SEED = 1
TURN = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@cache
def recording():
    return recorded(drawn(SEED), SEED, seconds=12.0)


def with_wrench(change):
    """The recording with another wrench (n, 6)."""
    run = recording()
    names = [f"{axis}.{SENSOR}" for axis in AXES]
    changed = change(np.column_stack([run.channels[name].value for name in names]))
    channels = {name: replace(run.channels[name], value=y) for name, y in zip(names, changed.T, strict=True)}
    return replace(run, channels={**run.channels, **channels})


def zeroed(wrench):
    half = len(wrench) // 2
    return np.vstack([wrench[:half], wrench[half:] - wrench[half : half + 5].mean(axis=0)])


def in_base(wrench):
    q = np.column_stack([recording().channels[f"q.{joint}"].value for joint in robot().joint_names])
    axes = measured(drawn(SEED), q, 0 * q, 0 * q)[2]
    return np.hstack([np.einsum("nij,nj->ni", axes, wrench[:, k : k + 3]) for k in (0, 3)])


def gripped(wrench):
    later = np.arange(len(wrench)) > len(wrench) // 2
    return wrench + np.outer(later, [3.0, -4.0, 5.0, 0.5, 0.4, 0.3])


def clipped(wrench):
    return np.clip(wrench, *np.quantile(wrench, [0.1, 0.9], axis=0))


MISTAKES = {
    "sign": (lambda y: -y, "wrench_sign", "wrong"),
    "turned": (lambda y: np.hstack([y[:, :3] @ TURN.T, y[:, 3:] @ TURN.T]), "wrench_frame", "wrong"),
    "base": (in_base, "wrench_frame", "wrong"),
    "zeroed": (zeroed, "wrench_zeroed", "wrong"),
    "gripped": (gripped, "wrench_zeroed", "suspect"),
    "saturated": (clipped, "saturated", "suspect"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_of_a_wrench_is_found(mistake):
    change, kind, severity = MISTAKES[mistake]
    found = [c for c in inspect_runs([with_wrench(change)], sensed_model()).checks if c.severity.key != "note"]
    assert {(check.kind, check.severity.key) for check in found} - {("frozen", "suspect")} == {(kind, severity)}


@pytest.mark.parametrize("mistake", ["sign", "turned"])
def test_a_corrected_wrench_is_the_sound_one(mistake):
    run = with_wrench(MISTAKES[mistake][0])
    mended = inspect_runs([run], sensed_model()).corrected()[run.name].applied_to(run)
    for axis in AXES:
        assert mended.channels[f"{axis}.{SENSOR}"].value == pytest.approx(
            recording().channels[f"{axis}.{SENSOR}"].value
        )


@pytest.mark.parametrize("seed", [2, 4, 7, 8, 10, 13])
def test_a_wrong_sign_of_the_torque_alone_is_found_beside_a_turned_sensor_and_a_pull(seed):
    assert drawn(seed).faults.keys() & {"wrench_rotation", "cable_pull"}
    run = recorded(drawn(seed), seed, seconds=12.0)
    torques = {name: replace(c, value=-c.value) for name, c in run.channels.items() if name.startswith("t")}
    (check,) = (c for c in inspect_runs([replace(run, channels={**run.channels, **torques})], sensed_model()).checks)
    assert check.kind == "wrench_sign"
    assert "its torque has the wrong sign" in check.sentence


@pytest.mark.parametrize("seed", range(4))
def test_faults_of_a_sensor_are_no_mistakes_of_its_recording(seed):
    found = inspect_runs([recorded(drawn(seed), seed, seconds=12.0)], sensed_model())
    assert not [check for check in found.checks if check.severity.key != "note"]
