import numpy as np
import pytest
from hidden_effects import arm as hidden_arm

from armdyn.errors import InputError
from armdyn.experiments.columns import Columns, present, random_states
from armdyn.experiments.series import AxisMotion


def extended(model, effects):
    for effect in effects:
        model = model.with_effect(effect)
    return Columns(present(model), 100.0)


@pytest.fixture
def states(baxter):
    return random_states(baxter.arm, 20)


def test_a_payloads_column_is_the_torque_that_mujoco_finds_for_it(baxter, effects, states):
    columns = extended(baxter, effects("payload"))
    place = {f"payload.{axis}[right_w2]": p for axis, p in zip("xyz", hidden_arm.PAYLOAD_PLACE, strict=True)}
    columns = Columns(columns.model.with_values(place), 100.0)
    torque = columns.at(states)[:, :, columns.of("payload")[0]] * columns.noise
    motion = states.q, states.v, states.a
    expected = hidden_arm.rigid_torque(*motion, payload=1.3) - hidden_arm.rigid_torque(*motion, payload=0.3)
    assert torque == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_a_links_mass_column_is_what_mujoco_finds_for_a_heavier_link(baxter, effects, states):
    columns = extended(baxter, effects("link_inertia"))
    index = columns.model.names.index("link_inertia.mass[right_e0]")
    torque = columns.at(states)[:, :, index] * columns.noise / columns.typical[index]
    motion, step = (states.q, states.v, states.a), 1e-4
    heavier = np.zeros(7)
    heavier[2] = step
    difference = hidden_arm.rigid_torque(*motion, heavier=heavier) - hidden_arm.rigid_torque(*motion, heavier=-heavier)
    expected = difference / (2 * step)
    assert torque == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


def test_torques_are_mujocos_with_the_damping_of_the_urdf(baxter, states):
    torque = Columns(baxter, 100.0).torque(states)
    expected = hidden_arm.rigid_torque(states.q, states.v, states.a)
    expected = expected + np.asarray(baxter.arm.model.damping) * states.v
    assert torque == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_slopes_are_those_of_finite_differences(shoulder, effects):
    columns = extended(shoulder, effects("joint_coulomb_friction link_inertia gravity_spring joint_load_friction"))
    states, rng = random_states(shoulder.arm, 6), np.random.default_rng(1)
    by_columns = rng.standard_normal((6, 3, len(columns.unknowns)))
    by_torque = rng.standard_normal((6, 3))

    def total(moved):
        return float(np.sum(columns.at(moved) * by_columns) + np.sum(columns.torque(moved) * by_torque))

    found = columns.with_slopes(states)[2](by_columns, by_torque)
    for k, gradient in enumerate(found):
        direction = rng.standard_normal(states.q.shape)
        parts = [states.q, states.v, states.a]
        h, ends = 1e-5, []
        for sign in (1, -1):
            moved = list(parts)
            moved[k] = parts[k] + sign * h * direction
            ends.append(total(AxisMotion(*moved)))
        measured = (ends[0] - ends[1]) / (2 * h)
        assert measured == pytest.approx(float(np.sum(gradient * direction)), rel=1e-3)


def test_an_effect_that_acts_through_its_mass_has_one(baxter, effects):
    columns = extended(baxter, effects("payload"))
    assert columns.model.value("payload.mass[right_w2]") == 1.0
    assert np.all(np.any(columns.at(random_states(baxter.arm, 20)) != 0.0, axis=(0, 1)))


def test_a_delay_is_refused_in_one_line(shoulder, effects):
    with pytest.raises(InputError, match="depends on what was before") as caught:
        extended(shoulder, effects("torque_delay")).at(random_states(shoulder.arm, 2))
    assert "\n" not in str(caught.value)
