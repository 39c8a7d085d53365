"""What a model cannot explain shows its law before anyone names it; the physics that is hidden is written elsewhere."""

import numpy as np
import pytest
from worlds.baxter import JOINTS, generate, motion

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.compare import compare
from armdyn.identify.diagnose import diagnose
from armdyn.identify.repair import repair
from armdyn.identify.residual.force_law import SQUARE_SHAPE, STEP_SHAPE, VISCOUS_SHAPE, find_force_law
from armdyn.identify.residual.missing_force import (
    MIN_INDEPENDENT_SAMPLES_PER_BIN,
    MissingForce,
    compare_missing_forces,
    force_curves,
    pool_curves,
)
from armdyn.identify.studies import make_study
from armdyn.run import Channel, Run

FRICTION, JOINT, SEED = 1.2, "right_e1", 5
OUTSIDE = 3.5  # standard errors that none of a few hundred points should reach by chance alone


def with_dry_friction(recording):
    """Coulomb's friction with a sharp sign on one joint of an arm that has none."""
    run = generate(None, 1.0, SEED, recording=recording)
    torque = run.channels[f"tau.{JOINT}"]
    speed = motion(SEED, recording).at(torque.time)[1][:, JOINTS.index(JOINT)]
    rubbed = Channel(torque.time, torque.value + FRICTION * np.sign(speed), "N m")
    return Run(run.name, {**run.channels, f"tau.{JOINT}": rubbed}, {}, run.noise)


@pytest.fixture(scope="module")
def study():
    runs = [with_dry_friction(k) for k in range(2)]
    return make_study(
        arm_model(robot="baxter"), runs, [], [CATALOGUE["joint_coulomb_friction"], CATALOGUE["torque_offset"]]
    )


@pytest.fixture(scope="module")
def repaired(study):
    return repair(study)


def of(found, joint, against):
    (curve,) = (c for c in pool_curves(found) if (c.joint, c.against) == (joint, against))
    return curve


def test_dry_friction_is_a_step_of_twice_its_size_on_its_joint(repaired):
    curve = of(repaired.missing_force, JOINT, "speed")
    moving = np.abs(curve.x) > 0.2
    np.testing.assert_allclose(curve.as_given[moving], FRICTION * np.sign(curve.x[moving]), atol=0.1)
    assert repaired.missing_force[0].joint == JOINT


def test_joints_that_lack_nothing_are_flat(repaired):
    for curve in repaired.missing_force:
        if curve.joint != JOINT:
            assert np.abs(curve.as_given / curve.std).max() < OUTSIDE


def test_what_is_left_of_a_repaired_force_is_flat(repaired):
    curve = of(repaired.missing_force, JOINT, "speed")
    moving = np.abs(curve.x) > 0.05  # where it turns round, a sharp sign is not known better than the speed
    # What smoothing the positions does to the fastest motion is as large as the noise of one sample.
    assert np.abs(curve.repaired[moving]).max() < 0.05 * FRICTION
    assert np.mean(np.abs(curve.repaired) < 3.0 * curve.repaired_std) > 0.9


@pytest.mark.parametrize("answer", [compare, diagnose, repair])
def test_the_sentence_tells_the_law_and_its_size(study, answer):
    expected = (
        f"The missing torque of {JOINT} steps by 2.4 N m where the joint reverses: dry friction of half that size. "
    )
    found = answer(study)
    told = found.sentence if answer is compare else found.remarks
    assert f"{told} ".startswith(expected)


def test_a_friction_that_drives_is_called_none():
    given = [
        MissingForce(u.run, u.joint, u.unit, u.time, -u.value, u.against) for u in map(_samples, range(2), [1.0, 1.0])
    ]
    assert find_force_law(force_curves(given)).sentence.endswith("which drives the motion and is not friction")


def test_what_slows_one_of_several_speeds_is_friction():
    """An acceleration of one state of a base of one's own, which is named as a joint is."""
    rng, time = np.random.default_rng(0), np.arange(0.0, 20.0, 0.02)
    speed = np.sin(2.0 * time)
    slowed = MissingForce(
        "a", "lower_rate", "rad/s^2", time, -speed + 0.1 * rng.normal(size=1000), {"speed": (speed, "rad/s")}
    )
    told = find_force_law(force_curves([slowed])).sentence
    assert told.startswith("the missing acceleration of lower_rate grows in proportion to the speed, by 1 rad/s^2")
    assert told.endswith(": viscous friction")


def test_beside_a_drag_less_viscous_friction_than_was_fitted_is_no_drive():
    given = [_samples(seed, 0.0, 0.4) for seed in range(2)]
    less = [
        MissingForce(u.run, u.joint, u.unit, u.time, u.value - 0.6 * u.against["speed"][0], u.against) for u in given
    ]
    sentence = find_force_law(force_curves(less)).sentence
    assert "falls in proportion to the speed" in sentence
    assert sentence.endswith(": drag")


def _samples(seed, friction, drag=0.0, noise=0.2):
    """White noise with what a friction and a drag take, over speeds of a swing."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, 40.0, 0.05)
    speed = (1.0 + 2.0 * np.exp(-time / 20.0)) * np.sin(5.0 * time)
    value = friction * np.sign(speed) + drag * speed * np.abs(speed) + noise * rng.standard_normal(len(time))
    return MissingForce(f"{seed}.csv", "a", "N m", time, value, {"speed": (speed, "rad/s")})


@pytest.mark.parametrize(
    ("friction", "drag", "shapes"),
    [(0.5, 0.0, [STEP_SHAPE]), (0.0, 0.2, [SQUARE_SHAPE]), (0.5, 0.2, [STEP_SHAPE, SQUARE_SHAPE])],
)
def test_a_law_is_told_by_its_shape_with_its_size(friction, drag, shapes):
    terms = find_force_law(force_curves([_samples(0, friction, drag), _samples(1, friction, drag)])).terms
    assert [term.shape for term in terms] == shapes
    sizes = {STEP_SHAPE: 2 * friction, SQUARE_SHAPE: drag}
    assert [term.size for term in terms] == pytest.approx([sizes[shape] for shape in shapes], rel=0.15)


@pytest.mark.parametrize(
    ("drag", "more"),
    [
        (0.0, ": dry friction of half that size"),
        (
            -0.02,
            " and grows with the square of the speed, by 0.02 rad/s^2 per (rad/s)^2: dry friction of half that size "
            "and air drag",
        ),
    ],
)
def test_a_swing_is_slowed_in_words_of_a_swing(drag, more):
    slowed = _samples(0, -0.17, drag, noise=0.01)
    swing = MissingForce("a.csv", None, "rad/s^2", slowed.time, slowed.value, slowed.against)
    expected = f"the missing acceleration steps by 0.34 rad/s^2 where the swing reverses{more}"
    assert find_force_law(force_curves([swing])).sentence == expected


def test_recordings_with_a_sample_for_each_bin_have_errors():
    short = [
        MissingForce(u.run, u.joint, u.unit, u.time[:9], u.value[:9], {"speed": (u.against["speed"][0][:9], "rad/s")})
        for u in (_samples(0, 1.0), _samples(1, 1.0))
    ]
    assert all(np.all(curve.std > 0.0) for curve in pool_curves(force_curves(short)))


@pytest.mark.parametrize("seed", range(20))
def test_noise_follows_no_law(seed):
    assert find_force_law(force_curves([_samples(seed, 0.0)])) is None


def test_too_little_is_left_untold():
    """Between a straight line and a step that noise hides, the picture shows what there is, and nothing is named."""
    time = np.arange(0.0, 4.0, 0.05)
    rng = np.random.default_rng(3)
    speed = np.sin(5.0 * time)
    value = 0.05 * speed + 0.2 * rng.standard_normal(len(time))
    assert (
        find_force_law(force_curves([MissingForce("a", "a", "N m", time, value, {"speed": (speed, "rad/s")})])) is None
    )


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_standard_errors_hold_for_white_and_coloured_noise(colour):
    """Of the means, over many recordings, about a third lie outside one standard error; a few more in coloured noise,
    whose correlation is seen less than it is where there are eight independent samples in a bin.
    """
    outside = []
    for seed in range(60):
        rng, time = np.random.default_rng(seed), np.arange(0.0, 40.0, 0.02)
        value = rng.standard_normal(len(time))
        for k in range(1, len(value)):
            value[k] += colour * value[k - 1]
        (slow,) = force_curves([MissingForce("a", "a", "N", time, value, {})])
        outside += (np.abs(slow.as_given) > slow.std).tolist()
    assert 0.25 < np.mean(outside) < (0.42 if colour else 0.36)


def test_bins_hold_equally_many_samples_and_enough_of_them():
    rng = np.random.default_rng(0)
    for samples in (9, 70, 300, 5000):
        x = rng.standard_normal(samples)
        time = np.arange(float(samples))
        found = force_curves([MissingForce("a", "a", "N", time, rng.standard_normal(samples), {"speed": (x, "m/s")})])
        for curve in found:
            assert 8 <= len(curve.x) <= 32
            assert np.all(np.diff(curve.x) > 0.0)
            assert len(curve.x) == 8 or samples / len(curve.x) >= MIN_INDEPENDENT_SAMPLES_PER_BIN


def test_nothing_is_drawn_against_what_stands_still():
    time = np.arange(100.0)
    still = MissingForce("a", "a", "N m", time, np.sin(time), {"speed": (np.zeros(100), "rad/s")})
    assert {curve.against for curve in force_curves([still])} == {"time"}


def test_what_an_effect_explains_is_its_law_without_the_noise(study):
    """Dry friction by sampled positions turns round where the speed does; the noise is 0.3 N m of the torque."""
    first = study.first()
    (candidate,) = (c for c in study.candidates if c.effect == "joint_coulomb_friction")
    curve = of(compare_missing_forces(first, study.fit_base_with_effects([candidate], first), law=True), JOINT, "speed")
    moving = np.abs(curve.x) > 0.2
    given, drawn = (np.abs(y - FRICTION * np.sign(curve.x))[moving].max() for y in (curve.as_given, curve.law))
    assert drawn < 0.02 < given


def test_a_data_frame_holds_every_point(study, repaired):
    pytest.importorskip("pandas", reason="data frames need pandas: pip install 'armdyn[notebook]'")
    frame = repaired.to_dataframe("missing_force")
    assert list(frame.columns) == ["run", "joint", "unit", "against", "x_unit", "x", "as_given", "std", "repaired"]
    assert len(frame) == sum(len(curve.x) for curve in repaired.missing_force)
    assert compare(study).to_dataframe("missing_force")["repaired"].isna().all()
    assert not frame["repaired"].isna().any()


def test_viscous_friction_is_a_straight_line():
    run = generate("joint_viscous_friction", 1.0, 2)
    found = compare(make_study(arm_model(robot="baxter"), [run], [], []))
    told = find_force_law(found.missing_force)
    assert [term.shape for term in told.terms] == [VISCOUS_SHAPE]
    assert told.terms[0].size == pytest.approx(2.0, rel=0.05)
    assert len(told.similar_joints) == 6
