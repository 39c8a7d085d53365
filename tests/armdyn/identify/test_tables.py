"""What tables say in words."""

import pytest

from armdyn.arm.drives import Servo
from armdyn.identify.tables import drive_section
from armdyn.recording.units import KnownQuantity


def drive(value, std):
    return {"sts3215": Servo(("elbow",), gain=KnownQuantity(value, std, "N m/rad"))}


@pytest.mark.parametrize(("found", "surprising"), [(14.0, True), (5.0, True), (9.7, False)])
def test_a_gain_that_is_not_the_usual_one_is_said(found, surprising):
    said = drive_section(drive(found, 0.25), drive(8.9, 0.89), {}).sentence
    assert ("times the stated one (8.9 +/- 0.89 N m/rad)" in said) == surprising
    assert "times the stated" not in drive_section(drive(found, 0.25), {"sts3215": Servo(("elbow",))}, {}).sentence
