"""What a repair says, for steps made by hand."""

from types import SimpleNamespace as Plain

import numpy as np
import pytest

from armdyn.identify.diagnose import decide_verdict
from armdyn.identify.explained_share import ChannelScale, RepairStep, explained_share
from armdyn.identify.holdout import HoldoutKind
from armdyn.identify.residual.block import ResidualBlock
from armdyn.identify.selection.search import Search
from armdyn.identify.sentence import RepairResidual as Rest
from armdyn.identify.sentence import Verdict, repair_sentences, total_errors
from armdyn.identify.settings import DEFAULT_SETTINGS
from armdyn.run import Channel

ARM = ChannelScale({"tau.a": "N m", "tau.b": "N m"}, {"tau.a": 0.3, "tau.b": 0.4})
CELL = ChannelScale({"load_force": "N"}, {"load_force": 0.003})
NOISE, HELD_OUT = Rest(exceeds_noise=False), HoldoutKind.HELD_OUT


def step(rmse, added=(), joints=(), *, tied=(), held_out=None, exam=None):
    return RepairStep(tuple(added), tuple(joints), tuple(tied), rmse, held_out or rmse, 1.0, 0.0, exam or {})


GIVEN = step({"tau.a": 30.0, "tau.b": 40.0})
SPRING = step({"tau.a": 3.0, "tau.b": 4.0}, ["gravity_spring"], ["left_s1"])
LAST = step({"tau.a": 0.3, "tau.b": 0.4}, ["payload", "torque_delay", "torque_gain"], ["b"])
BOTH = step({"tau.a": 3.0, "tau.b": 4.0}, ["joint_coulomb_friction"], ["a", "b"])
VISCOUS = step({"tau.a": 0.3, "tau.b": 0.4}, ["joint_viscous_friction"], ["b", "a"])
LOADED = step({"tau.a": 0.3, "tau.b": 0.39}, ["payload"], ["b"])
EXAM = [
    step({"tau.a": 30.0}, exam={"tau.a": 20.0}), step({"tau.a": 3.0}, ["gravity_spring"], ["b"], exam={"tau.a": 10.0}),
]  # fmt: skip
TIED = [step({"load_force": 0.03}), step({"load_force": 0.006}, ["wind"], tied=["bob"])]
REPAIRS = {
    "an effect on its joint": ([GIVEN, SPRING], HoldoutKind.LEAVE_ONE_OUT, ARM, Rest(True, "it depends on v.b")),
    "one that explains a little": (
        [GIVEN, SPRING],
        HELD_OUT,
        ARM,
        Rest(True, further_effect="rotor_inertia on left_e0"),
    ),
    "an exam": (EXAM, HoldoutKind.EXAM, ARM, NOISE),
    "an effect that was asked for": ([GIVEN, SPRING], HELD_OUT, ARM, Rest(True, searched=False)),
    "a larger error": ([GIVEN, step({"tau.a": 60.0, "tau.b": 80.0}, ["payload"])], HELD_OUT, ARM, Rest(True)),
    "several effects": ([GIVEN, SPRING, LAST], HELD_OUT, ARM, NOISE),
    "many effects": ([GIVEN, step(SPRING.rmse, [f"effect_{i}" for i in range(6)])], HELD_OUT, ARM, NOISE),
    "effects on the same joints": ([GIVEN, BOTH, VISCOUS, LOADED], HELD_OUT, ARM, NOISE),
    "ties and warnings": (TIED, HELD_OUT, CELL, Rest(False, warnings=["the link of b weighs 241 kg in the model"])),
    "nothing": ([GIVEN], HoldoutKind.TRAINING, ARM, NOISE),
}


@pytest.mark.parametrize("repair", REPAIRS.values(), ids=REPAIRS)
def test_a_repair_is_told_in_two_sentences(repair, complains):
    text = repair_sentences(*repair)
    assert text.endswith(".")
    assert text.count(". ") == 1
    complains.line(text)


def test_totals_are_over_channels_of_one_unit():
    units = {"tau.a": "N m", "tau.b": "N m", "tau.slide": "N"}
    assert total_errors({"tau.a": 3.0, "tau.b": 4.0, "tau.slide": 2.0}, units) == {"N m": 5.0, "N": 2.0}


def test_explained_is_the_share_of_the_squared_error_above_the_noise():
    assert explained_share(GIVEN, SPRING, ARM) == pytest.approx(1 - (25 - 0.25) / (2500 - 0.25))
    at_noise = step({"tau.a": 0.3, "tau.b": 0.4}, ["payload"])
    assert explained_share(GIVEN, at_noise, ARM) == 1.0
    assert explained_share(at_noise, at_noise, ARM) == 1.0
    assert explained_share(SPRING, GIVEN, ARM) < 0.0


def test_channels_of_different_units_are_weighed_by_their_noise():
    scale = ChannelScale({"load_force": "N", "swing_angle": "rad"}, {"load_force": 1.0, "swing_angle": 0.001})
    before = step({"load_force": 11.0, "swing_angle": 0.011})
    after = step({"load_force": 1.0, "swing_angle": 0.011}, ["sensor_bias"])
    assert explained_share(before, after, scale) == pytest.approx(0.5)


@pytest.mark.parametrize(("level", "verdict"), [(3.0, Verdict.EXPLAINED), (3.5, Verdict.UNKNOWN_EFFECT)])
def test_what_is_left_without_a_shape_is_coloured_noise_unless_it_is_far_above_an_estimated_one(level, verdict):
    time = np.arange(100.0)
    block = ResidualBlock(
        "a", "q.x", Channel(time, time, "rad"), np.full(100, level), np.zeros((100, 0)), 1e-3, np.zeros(0, bool)
    )
    study = Plain(
        ignores_input_errors=False, settings=DEFAULT_SETTINGS, leaves_noise=lambda *_: None,
        chi2_by_stated_noise=lambda _blocks: (0.0, 0),
    )  # fmt: skip
    step = Plain(tests=Plain(fails=True), fit=Plain(blocks=(block,), chi2_per_sample=level**2))
    assert decide_verdict(study, Search((step,)), Plain(significant=False)) is verdict
