import sys
from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from PIL import Image
from simulated_truth import load_truth

from armdyn.errors import InputError
from pipeline.box import Box
from pipeline.robot.hidden import resolve_hidden
from pipeline.robot.picture import render_swing
from pipeline.robot.scene import build_scene
from pipeline.robot.settings import PlantSettings, ServoSettings

AROUND_THE_LOAD = Box(near_wall=-0.15, width=0.30, rim=0.30, height=0.15)


def test_load_in_the_box_counts_after_a_fifth_of_a_second(plant):
    robot = plant(box=AROUND_THE_LOAD)
    robot.advance(0.19)
    assert not robot.load_in_box()
    robot.advance(0.02)
    assert robot.load_in_box()


@pytest.mark.parametrize(
    ("box", "angle"),
    [
        (Box(), 0.0),  # it hangs beside the box
        (replace(AROUND_THE_LOAD, rim=0.39), 0.0),  # above the rim
        (replace(AROUND_THE_LOAD, rim=0.366, near_wall=-0.5, width=1.0), 0.6),  # below the rim for 0.1 s at a time
    ],
)
def test_load_that_is_not_at_rest_in_the_box_does_not_count(plant, box, angle):
    robot = plant(box=box, rigid_arm=True, start_angle=angle)
    for _ in range(300):
        robot.advance(0.01)
        assert not robot.load_in_box()


@pytest.mark.parametrize("angle", [0.6, 1.2])
def test_wall_stops_the_load(still_pendulum, baxter, angle):
    # Released on the left, the load meets the wall that stands to the right of its lowest point.
    robot = still_pendulum(angle, box=Box(near_wall=0.05, width=0.3, rim=0.30, height=0.095))
    robot.advance(3.0)
    position = robot.history().load[:, 1] - baxter.line.origin[1]
    assert position.max() < 0.05 - robot.settings.load_radius + 0.004
    assert position.min() < -0.15


def test_floor_carries_a_load_whose_string_is_slack(still_pendulum, baxter):
    # Let go on its string from the right with the rim below its path, the load ends in the box and its string is slack.
    robot = still_pendulum(0.0, box=Box(near_wall=-0.2, width=0.4, rim=0.25, height=0.10))
    at_rest = baxter.line.origin[2] - 0.25 - 0.10 + robot.settings.load_radius
    robot._data.qpos[9] = at_rest + 0.03
    robot.advance(1.5)
    load = load_truth(robot)
    assert robot.load_in_box()
    assert load.tension == 0.0
    assert load.position[2] == pytest.approx(at_rest, abs=1e-3)
    assert np.linalg.norm(load.velocity) < 0.05


SETTINGS = PlantSettings(start_angle=0.9)


SMALL = (160, 120)


@pytest.fixture(scope="module")
def swing(plant):
    robot = plant(settings=SETTINGS, rigid_arm=True)
    robot.advance(1.0)
    return robot.history()


def _render(*arguments, **options):
    """Draw, or skip where there is no EGL."""
    try:
        render_swing(*arguments, **options)
    except InputError as error:
        if "EGL" not in str(error):
            raise
        pytest.skip(f"this machine cannot draw: {error}")


def _red(image):
    """Where the load is: the columns of saturated red pixels below the middle of the picture."""
    pixels = np.asarray(image.convert("RGB")).astype(int)
    lower = pixels[pixels.shape[0] // 2 :]
    return np.nonzero((lower[..., 0] > 120) & (lower[..., 1] < 50) & (lower[..., 2] < 50))[1]


def test_animation_shows_the_load_swinging_from_left_to_right(baxter, swing, tmp_path):
    path = tmp_path / "swing.gif"
    _render(baxter, SETTINGS, swing, path, 5.0, SMALL)
    with Image.open(path) as image:
        assert image.size == SMALL
        assert image.n_frames == 5
        first = _red(image).mean()
        image.seek(3)
        # The dots of the trail stay behind; the load itself is the rightmost.
        assert _red(image).max() > first + 20


def test_a_grid_holds_six_still_pictures(baxter, swing, tmp_path):
    path = tmp_path / "swing.png"
    _render(baxter, SETTINGS, swing, path, size=SMALL)
    with Image.open(path) as image:
        assert image.size == (3 * SMALL[0], 2 * SMALL[1])


def test_machine_without_egl_is_told_what_to_install(baxter, swing, tmp_path, monkeypatch, complains):
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    with complains(InputError):
        render_swing(baxter, SETTINGS, swing, tmp_path / "swing.png", size=SMALL)
    assert not (tmp_path / "swing.png").exists()


def test_other_file_types_and_an_empty_motion_are_refused(baxter, swing, plant, tmp_path, complains):
    with complains(InputError):
        render_swing(baxter, SETTINGS, swing, tmp_path / "swing.mp4")
    with complains(InputError):
        render_swing(baxter, SETTINGS, plant().history(), tmp_path / "swing.gif")


@pytest.fixture(scope="module")
def model(baxter):
    """The plant with the arm's rotors left out, which the URDF does not know either."""
    settings = PlantSettings(servo=ServoSettings(armature=(0.0,) * 7, friction=(0.0,) * 7))
    return build_scene(baxter, settings, resolve_hidden({}), 0.08, np.ones(7))


@pytest.fixture(scope="module")
def postures(baxter):
    rng = np.random.default_rng(3)
    return rng.uniform(baxter.limits.lower, baxter.limits.upper, (50, 7))


def _at(model, q, v=None):
    data = mujoco.MjData(model)
    data.qpos[:7] = q
    if v is not None:
        data.qvel[:7] = v
    mujoco.mj_forward(model, data)
    return data


def test_mass_matrix_of_the_arm_equals_pinocchio(baxter, model, postures):
    for q in postures:
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, _at(model, q), full)
        expected = pin.crba(baxter.model, baxter.model.createData(), q)
        expected = np.triu(expected) + np.triu(expected, 1).T
        np.testing.assert_allclose(full[:7, :7], expected, atol=1e-12)


def test_gravity_and_coriolis_torques_of_the_arm_equal_pinocchio(baxter, model, postures):
    rng = np.random.default_rng(4)
    for q in postures:
        v = rng.normal(size=7)
        expected = pin.rnea(baxter.model, baxter.model.createData(), q, v, np.zeros(7))
        np.testing.assert_allclose(_at(model, q, v).qfrc_bias[:7], expected, atol=1e-11)


def test_string_is_attached_where_pinocchio_puts_the_tool_point(model, baxter, postures):
    for q in postures:
        np.testing.assert_allclose(_at(model, q).site("pivot").xpos, baxter.tool_pose(q).translation, atol=1e-12)


def test_effort_limits_are_those_of_the_urdf(baxter, model):
    np.testing.assert_allclose(model.jnt_actfrcrange[:7, 1], baxter.limits.effort)


def test_box_stands_where_the_settings_say(baxter):
    settings = PlantSettings()
    model = build_scene(baxter, settings, resolve_hidden({}), 0.08, np.ones(7))
    near, far = model.geom("box_near"), model.geom("box_far")
    at_near, at_far = baxter.line.position(0.355), baxter.line.position(0.655)
    np.testing.assert_allclose(near.pos[:2], at_near[:2], atol=1e-12)
    np.testing.assert_allclose(far.pos[:2], at_far[:2], atol=1e-12)
    rim = near.pos[2] + near.size[2]
    assert rim == pytest.approx(at_near[2] - 0.285)
    floor = model.geom("box_floor")
    assert floor.pos[2] + floor.size[2] == pytest.approx(rim - 0.095)
