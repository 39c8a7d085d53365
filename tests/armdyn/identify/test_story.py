"""An arm's whole story is the same whatever the rate, in one recording or in several short ones."""

import pytest
from hidden_effects.generated_arm import generate

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.repair import repair
from armdyn.identify.study import Study


@pytest.mark.parametrize(("rate", "count"), [(100.0, 1), (500.0, 6), (100.0, 6)])
def test_a_creeping_wrist_behind_a_low_pass_is_told_whole(rate: float, count: int) -> None:
    # A gain and a friction that grows with the load hide each other; a fading friction hides behind an asymmetric one.
    robot = generate(2, story=True)
    catalogue = tuple(effect for effect in CATALOGUE.values() if effect.acts_on == "joint")
    mended = repair(Study(arm_model(robot.name), robot.cut(rate, 12.0, count).runs(), (), catalogue))
    found = {(effect.effect, joint) for effect in mended.steps[-1].effects for joint in effect.joints}
    assert found == {(hidden.effect, hidden.joint) for hidden in robot.truth}
