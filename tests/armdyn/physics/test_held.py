"""Inputs that keep their value between samples: what a controller commands, against the exact solution."""

import numpy as np
import pytest

from armdyn.errors import InputError
from armdyn.front import fit
from armdyn.physics import Equations, constant, physics, state
from armdyn.physics.model import physics_model
from armdyn.physics.recorded import is_piecewise_constant
from armdyn.run import Channel, Run

LAG, INTERVAL = 0.12, 0.02


def follower(channel, *, held=()):
    @physics(
        "follower", summary="A first-order lag.", source="of its own",
        parameters=(constant("lag", "s", 0.15, lower=0.01, upper=1.0),), states=(state("place", "m", typical=1.0),),
        inputs={channel: "m"}, held=held, outputs={"q.mass": "m"},
    )  # fmt: skip
    def equations(at):
        return Equations({"place": (at.input(channel).value - at["place"]) / at["lag"]}, {"q.mass": at["place"]})

    return physics_model(equations)


def followed(channel, command, *, late=0.0):
    """What a command makes of it; stamps of the command may come `late`, s."""
    place, decay = np.zeros(len(command)), np.exp(-INTERVAL / LAG)
    begun = np.exp(-(INTERVAL - late) / LAG)
    for k, value in enumerate(command[:-1]):
        before = command[max(k - 1, 0)]
        place[k + 1] = decay * place[k] + begun * (1 - decay / begun) * before + (1 - begun) * value
    time = INTERVAL * np.arange(len(command))
    channels = {channel: Channel(time + late, command, "m"), "q.mass": Channel(time, place, "m")}
    return Run("a.csv", channels, {}, {"q.mass": 1e-6})


def commanded(every, seed=1):
    """Levels that change every so many samples."""
    return np.repeat(0.05 * np.random.default_rng(seed).normal(size=400 // every), every)


@pytest.mark.parametrize(
    ("channel", "every", "held"),
    [("q.wanted", 1, ("q.wanted",)), ("q_cmd.mass", 1, ()), ("q.wanted", 13, ())],
)
@pytest.mark.parametrize("late", [0.0, 0.007])
def test_a_command_that_is_held_drives_the_motion_until_the_next_one(channel, every, held, late):
    found = fit(follower(channel, held=held), [followed(channel, commanded(every), late=late)])
    assert found.value("lag") == pytest.approx(LAG, rel=1e-5 if late == 0.0 else 1e-2)


@pytest.mark.parametrize(
    ("signal", "steps"),
    [
        (commanded(9), True),
        (commanded(1), False),
        (np.sin(0.05 * np.arange(400)), False),
        (np.round(3.0 * np.sin(0.02 * np.arange(400))), False),  # a coarse sensor
        (np.ones(400), False),
    ],
)
def test_jumps_of_unlike_sizes_between_which_a_signal_stands_still_are_commands(signal, steps):
    assert is_piecewise_constant(Channel(INTERVAL * np.arange(len(signal)), signal, "m")) is steps


def test_what_is_no_input_cannot_be_held(complains):
    with complains(InputError):
        follower("q.wanted", held=("q.other",))
