import sys

import numpy as np
import pytest
from PIL import Image

from armdyn.errors import InputError
from pipeline.robot.picture import render_swing
from pipeline.robot.settings import PlantSettings

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


def test_sheet_holds_six_moments(baxter, swing, tmp_path):
    path = tmp_path / "swing.png"
    _render(baxter, SETTINGS, swing, path, size=SMALL)
    with Image.open(path) as image:
        assert image.size == (3 * SMALL[0], 2 * SMALL[1])


def test_machine_without_egl_is_told_what_to_install(baxter, swing, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    with pytest.raises(InputError, match="libegl1"):
        render_swing(baxter, SETTINGS, swing, tmp_path / "swing.png", size=SMALL)
    assert not (tmp_path / "swing.png").exists()


def test_other_file_types_and_an_empty_motion_are_refused(baxter, swing, plant, tmp_path):
    with pytest.raises(InputError, match=r"\.gif"):
        render_swing(baxter, SETTINGS, swing, tmp_path / "swing.mp4")
    with pytest.raises(InputError, match="empty"):
        render_swing(baxter, SETTINGS, plant().history(), tmp_path / "swing.gif")
