import numpy as np
import pytest

from armdyn.errors import InputError, TaskFailedError
from pipeline.motion import LineSmoother, LineState
from pipeline.motion.reference import smooth_reference

from .lines import DT, baxter_limits, is_one_motion, sine, worst_excess

LIMITS = baxter_limits()
TIME = DT * np.arange(201)

INFEASIBLE = {
    "too fast": 0.3 * np.sin(2 * np.pi * 0.8 * TIME),
    "steps": 0.2 * np.sign(np.sin(2 * np.pi * 0.7 * TIME)),
    "beyond the ends": 0.8 * np.sin(2 * np.pi * 0.4 * TIME),
    "noise": np.random.default_rng(0).normal(0.0, 0.1, TIME.size),
}


def speeds(s: np.ndarray) -> np.ndarray:
    return np.gradient(s, DT)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_a_feasible_reference_stays_as_it_is():
    wanted = sine(0.15, 0.4, TIME.size)
    motion = smooth_reference(wanted.s, wanted.v, DT, LIMITS, start=wanted[0])
    assert np.max(np.abs(motion.s - wanted.s)) < 1e-5
    assert np.max(np.abs(motion.v - wanted.v)) < 1e-3


@pytest.mark.parametrize("name", INFEASIBLE)
def test_an_infeasible_reference_becomes_one_motion_nearer_to_it_than_any_online_scheme(name):
    s = INFEASIBLE[name]
    motion = smooth_reference(s, speeds(s), DT, LIMITS)
    assert worst_excess(LIMITS, motion) < 1e-9
    assert is_one_motion(list(motion), LIMITS.jerk, DT)
    if name != "noise":
        targets = [LineState(*map(float, row)) for row in zip(s, speeds(s), 0 * s, strict=True)]
        smoother = LineSmoother(LIMITS, DT, motion[0])
        online = [smoother.state, *(smoother.update(targets[k : k + 50]) for k in range(1, len(targets)))]
        assert rms(motion.s - s) < rms(np.array(online)[:, 0] - s)


def test_start_and_end_are_kept_or_refused_where_the_end_cannot_be_reached_in_time(complains):
    s = np.linspace(0.0, 0.25, TIME.size)
    start, end = LineState(0.02, 0.1, 0.5), LineState(0.3)
    motion = smooth_reference(s, speeds(s), DT, LIMITS, start=start, end=end)
    assert motion[0] == pytest.approx(start, abs=1e-8)
    assert motion.end == pytest.approx(end, abs=1e-8)
    with complains(TaskFailedError):
        smooth_reference(np.zeros(20), np.zeros(20), DT, LIMITS, end=LineState(0.5))


NONE = [(np.zeros(10), np.zeros(9)), (np.zeros(3), np.zeros(3)), (np.full(10, np.nan), np.zeros(10))]


@pytest.mark.parametrize(("s", "v"), [*NONE, (np.zeros((5, 2)), np.zeros((5, 2)))])
def test_what_is_no_reference_is_refused(s, v, complains):
    with complains(InputError):
        smooth_reference(s, v, DT, LIMITS)
