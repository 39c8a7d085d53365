"""Every kind of mistake is named and undone; what is real in an arm or pendulum is not a mistake."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from worlds import mistakes, sound_recordings

import armdyn
from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.inspection.check import Inspection, Severity, WrongRecordingError
from armdyn.inspection.correction import CorrectedReading, Correction
from armdyn.inspection.holds import longest_constant_stretch
from armdyn.inspection.inspect import inspect_runs
from armdyn.inspection.mistakes import roll_and_pitch
from armdyn.inspection.plausible import implausible_values, require_plausible
from armdyn.inspection.signals import largest_step
from armdyn.pendulum.model import pendulum_model
from armdyn.run import Channel, Run, read_run

from ..arm.conftest import RECORDINGS

OF_THE_SIGNAL = ("gap", "frozen", "repeated", "glitches", "saturated", "noise", "jitter", "counts lost", "no motion")
OF_AN_ARM = (
    "all in degrees", "rates in degrees", "rates in rpm", "mN m", "N cm", "all torques negated", "one torque negated",
    "rate negated", "torques late", "torques early", "rates late", "rates of other joints", "rates too slow",
    "one position negated", "all positions negated", "a quarter turn", "half a turn", "torques exchanged",
    "positions exchanged", "joints exchanged", "reversed torques", "shifted torques", "shifted joints",
)  # fmt: skip
PLACES = ("ceiling", "wall", "other wall", "slope", "gravity taken out")


@pytest.fixture(scope="module")
def panda():
    return arm_model(robot="panda", joints=mistakes.Plant("panda").joints)


@pytest.fixture(scope="module")
def sound():
    return sound_recordings.arm("panda", "as described", 0)


@pytest.fixture(scope="module")
def made(sound):
    every = [*mistakes.of_arms(sound, 0), *mistakes.of_signals(sound, np.random.default_rng(0))]
    return {m.name: m for m in (*every, *mistakes.mounted("panda", "as described", 0))}


def assert_named(mistake: mistakes.Mistake, found: Inspection) -> None:
    right = [c for c in found.checks if c.kind in mistake.kinds and _on(c.channels, mistake.channels)]
    assert right, f"{mistake.name}: {[(c.kind, c.sentence) for c in found.checks]}"
    assert {c.kind for c in found.wrong} <= mistake.kinds
    assert all(c.remedy for c in right)


def _on(named: Sequence[str], wanted: Sequence[str]) -> bool:
    return not wanted or bool(set(named) & set(wanted))


@pytest.mark.parametrize("name", [*OF_THE_SIGNAL, *OF_AN_ARM, *PLACES])
def test_a_mistake_is_named_on_its_channel(panda, made, name):
    assert_named(made[name], inspect_runs([made[name].run], panda))


@pytest.mark.parametrize("name", ["mN m", "torques exchanged", "a quarter turn", "torques late", "shifted joints"])
def test_the_corrected_recording_is_the_sound_one(panda, made, sound, name):
    found = inspect_runs([made[name].run], panda)
    mended = found.corrected()[made[name].run.name].applied_to(made[name].run)
    for channel, right in sound.run.channels.items():
        np.testing.assert_allclose(mended.channels[channel].value, right.value, rtol=1e-9, atol=1e-9)
        # Torques are late in themselves.
        np.testing.assert_allclose(mended.channels[channel].time, right.time, atol=0.01)


@pytest.mark.parametrize("real", sound_recordings.SOUND)
@pytest.mark.parametrize("robot", ["baxter", "ur5"])
def test_what_is_real_in_an_arm_is_no_mistake(robot, real):
    run = sound_recordings.arm(robot, real, 1).run
    found = inspect_runs([run], arm_model(robot=robot, joints=mistakes.Plant(robot).joints))
    assert not found.wrong, found.sentence
    assert not found.with_severity(Severity.SUSPECT), found.sentence


def test_two_mistakes_in_one_recording_are_undone_one_after_the_other(panda, sound):
    exchanged = mistakes.renamed(sound.run, {"panda_joint2": "panda_joint4", "panda_joint4": "panda_joint2"}, ["tau"])
    both = mistakes.scaled(exchanged, [f"tau.{j}" for j in panda.joints], 1e3)
    found = inspect_runs([both], panda)
    assert {c.kind for c in found.wrong} == {"torque_unit", "joints_swapped"}
    mended = found.corrected()[both.name].applied_to(both)
    for joint in panda.joints:
        name = f"tau.{joint}"
        np.testing.assert_allclose(mended.channels[name].value, sound.run.channels[name].value, rtol=1e-9)


@pytest.mark.parametrize(
    ("driven", "channels"),
    [
        (False, ("swing_angle",)),
        pytest.param(True, ("swing_angle", "swing_rate"), marks=pytest.mark.slow),
        pytest.param(True, ("swing_angle", "load_force"), marks=pytest.mark.slow),
    ],
)
def test_a_mistake_with_a_pendulum_is_named(driven, channels):
    sound = sound_recordings.pendulum("pivot_coulomb_friction", 3, driven=driven, channels=channels)
    model = pendulum_model(0.35, 0.1)
    assert inspect_runs([sound.run], model).usable
    for mistake in mistakes.of_pendulums(sound, 3):
        assert_named(mistake, inspect_runs([mistake.run], model))


@pytest.mark.parametrize("late", [0.03, 0.05, 0.08])
@pytest.mark.parametrize("channels", [("swing_angle", "swing_rate"), ("swing_angle", "load_force")])
def test_a_sensor_that_lags_is_no_late_clock(channels, late):
    run = sound_recordings.pendulum("pivot_coulomb_friction", 3, driven=True, channels=channels).run
    assert inspect_runs([mistakes.late(run, channels, late)], pendulum_model(0.35, 0.1)).usable


@pytest.mark.parametrize("name", ["all in degrees", "mN m"])
def test_without_a_model_units_are_held_against_ranges(made, sound, name):
    assert_named(made[name], inspect_runs([made[name].run]))
    assert not inspect_runs([sound.run]).with_severity(Severity.SUSPECT)


def test_a_sample_beside_the_others_is_no_lost_count(sound):
    joint = sound.run.channels["q.panda_joint2"]
    value = joint.value.copy()
    value[700] -= 0.1
    assert largest_step(Channel(joint.time, value, joint.unit)) is None
    value[700:] -= 0.1
    value[700] += 0.1
    assert largest_step(Channel(joint.time, value, joint.unit)) is not None


def test_an_encoder_of_a_joint_that_rests_is_not_stuck(sound):
    joint = sound.run.channels["q.panda_joint2"]
    value = np.round(joint.value, 6)
    value[:40] = value[39]
    value[40:52] = value[39] + np.cumsum(np.full(12, 1e-6))
    value[52:] += value[51] - value[52]
    assert longest_constant_stretch(Channel(joint.time, value, joint.unit)) is None


def test_without_a_model_rates_tell_their_units(made):
    assert_named(made["rates in degrees"], inspect_runs([made["rates in degrees"].run]))


here = pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings of ../shared are not here")


@here
@pytest.mark.parametrize(
    ("folder", "urdf", "robot"),
    [("arm_dfki_double", "double_pendulum_C1.urdf", None), ("arm_gen3", "gen3.urdf", None),
     ("arm_panda_unisa", None, "panda"), ("emps", "emps.urdf", None)],
)  # fmt: skip
def test_real_recordings_of_arms_are_never_called_wrong(folder, urdf, robot):
    for file in sorted((RECORDINGS / folder).glob("*.csv")):
        run = read_run(file)
        model = arm_model(RECORDINGS / folder / urdf if urdf else None, robot, list(run.joints))
        assert inspect_runs([run], model).usable, file


@here
def test_real_recordings_of_pendulums_are_never_called_wrong():
    for file in sorted(RECORDINGS.glob("pend*/*.csv")):
        assert inspect_runs([read_run(file)], pendulum_model(0.35, 0.1)).usable, file


T = np.arange(0.0, 1.0, 0.01)
READINGS = st.builds(
    CorrectedReading, st.sampled_from(["q.a", "q.b"]), st.sampled_from([-1.0, 1.0, 1e-3, 57.3]), st.floats(-2, 2),
    st.sampled_from([0.0, 0.1, -0.2]),
)  # fmt: skip
CORRECTIONS = st.builds(Correction, st.dictionaries(st.sampled_from(["q.a", "q.b"]), READINGS))


def recorded() -> Run:
    return Run("r", {"q.a": Channel(T, np.sin(T), "rad"), "q.b": Channel(T, np.cos(3 * T), "rad")})


@given(CORRECTIONS, CORRECTIONS)
def test_two_corrections_are_one(first, second):
    apart, together = second.applied_to(first.applied_to(recorded())), first.followed_by(second).applied_to(recorded())
    for name in ("q.a", "q.b"):
        np.testing.assert_allclose(together.channels[name].value, apart.channels[name].value, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(together.channels[name].time, apart.channels[name].time, atol=1e-12)


@given(st.floats(-1.4, 1.4), st.floats(-3.0, 3.0))
def test_roll_and_pitch_turn_gravity_to_where_it_was_found(pitch, roll):
    gravity = -9.81 * np.array([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
    np.testing.assert_allclose(roll_and_pitch(gravity), (roll, pitch), atol=1e-9)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("payload", {"payload.mass[panda_joint7]": 6336.0}),
        ("link_inertia", {"link_inertia.mass[panda_joint3]": 4.0}),
        ("base_tilt", {"base_tilt.roll": 3.0}),
        ("torque_offset", {"torque_offset.torque[panda_joint2]": -184.6}),
        ("torque_delay", {"torque_delay.time[panda_joint2]": 3e7}),
    ],
)
def test_what_nothing_has_is_said(effect, values):
    model = arm_model(robot="panda", joints=mistakes.Plant("panda").joints, effects=[CATALOGUE[effect]])
    assert implausible_values(model) == []
    wide = {name: replace(model.parameters[name], value=value, upper=np.inf) for name, value in values.items()}
    found = implausible_values(model.with_parameters(wide))
    assert [check.kind for check in found] == ["implausible_model"]
    assert "check your recording" in found[0].remedy


def test_what_a_user_told_the_model_is_no_verdict(complains):
    model = arm_model(robot="panda", joints=mistakes.Plant("panda").joints, effects=[CATALOGUE["base_tilt"]])
    on_a_wall = model.with_values({"base_tilt.roll": 1.57})
    require_plausible(on_a_wall, [], on_a_wall)
    with complains(WrongRecordingError):
        require_plausible(on_a_wall, [], model)


def test_a_length_at_the_end_of_its_range_is_said():
    assert implausible_values(pendulum_model(0.35, 0.1)) == []
    assert [check.channels for check in implausible_values(pendulum_model(5.0, 0.1))] == [("length",)]


def test_wrong_recordings_end_a_comparison_and_trusted_ones_do_not():
    joints = mistakes.Plant("panda").joints
    model = arm_model(robot="panda", joints=joints)
    sound = sound_recordings.arm("panda", "as described", 0, duration=6.0)
    wrong = mistakes.scaled(sound.run, [f"tau.{j}" for j in joints], 1e3)
    with pytest.raises(WrongRecordingError) as caught:
        armdyn.compare(model, [wrong])
    assert caught.value.inspection.wrong[0].kind == "torque_unit"
    assert armdyn.compare(model, [wrong], trust_data=True).fit.chi2_per_sample > 1.0


def test_a_run_is_cut_where_samples_are_missing():
    joints = mistakes.Plant("panda").joints
    model = arm_model(robot="panda", joints=joints)
    sound = sound_recordings.arm("panda", "as described", 0, duration=8.0)
    found = armdyn.compare(model, [mistakes.without(sound.run, 4.0, 5.2)])
    assert [run.name for run in found.fit.problem.runs] == [f"{sound.run.name}#1", f"{sound.run.name}#2"]
    assert any("cut there" in text for text in found.left_out)
