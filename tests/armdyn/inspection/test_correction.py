import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from armdyn.channels import Channel
from armdyn.inspection.correction import Correction, Reading
from armdyn.inspection.hypotheses import rolled
from armdyn.run import Run

T = np.arange(0.0, 1.0, 0.01)
READINGS = st.builds(
    Reading, st.sampled_from(["q.a", "q.b"]), st.sampled_from([-1.0, 1.0, 1e-3, 57.3]), st.floats(-2, 2),
    st.sampled_from([0.0, 0.1, -0.2]),
)  # fmt: skip
CORRECTIONS = st.builds(Correction, st.dictionaries(st.sampled_from(["q.a", "q.b"]), READINGS))


def recorded() -> Run:
    return Run("r", {"q.a": Channel(T, np.sin(T), "rad"), "q.b": Channel(T, np.cos(3 * T), "rad")})


@given(CORRECTIONS, CORRECTIONS)
def test_two_corrections_are_one(first, second):
    apart, together = second.of(first.of(recorded())), first.then(second).of(recorded())
    for name in ("q.a", "q.b"):
        np.testing.assert_allclose(together.channels[name].value, apart.channels[name].value, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(together.channels[name].time, apart.channels[name].time, atol=1e-12)


@given(st.floats(-1.4, 1.4), st.floats(-3.0, 3.0))
def test_roll_and_pitch_turn_gravity_to_where_it_was_found(pitch, roll):
    gravity = -9.81 * np.array([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
    np.testing.assert_allclose(rolled(gravity), (roll, pitch), atol=1e-9)
