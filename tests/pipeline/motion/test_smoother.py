import math
from types import SimpleNamespace

import numpy as np
import pytest
import ruckig
from hypothesis import given, settings
from hypothesis import strategies as st

from armdyn.errors import InputError
from pipeline.motion import LineLimits, LineSmoother, LineState, planner

from .lines import DT, baxter_limits, is_one_motion, sine, worst_excess, worst_excess_between

LIMITS = baxter_limits()


def followed(reference: list[LineState], smoother: LineSmoother, ahead: int = 0) -> list[LineState]:
    """The smoother's states, which start with the one that it has."""
    targets = [reference[k : k + ahead] if ahead else reference[k] for k in range(1, len(reference))]
    return [smoother.state, *map(smoother.update, targets)]


def test_a_feasible_reference_is_reproduced_exactly():
    reference = list(sine(0.15, 0.5, 400))
    states = followed(reference, LineSmoother(LIMITS, DT, reference[0]))
    assert np.max(np.abs(np.array(states) - np.array(reference))) < 1e-9


def test_a_reference_is_caught_up_with_from_rest_and_after_an_infeasible_stretch():
    reference = list(sine(0.15, 0.5, 300))
    # A jump of 0.1 m for 0.3 s in the middle.
    broken = [LineState(r.s + 0.1 * (100 <= k < 130), r.v, r.a) for k, r in enumerate(reference)]
    for asked, start, lost, met in ((reference, LineState(0.0), 30, 60), (broken, broken[0], 140, 200)):
        states = followed(asked, LineSmoother(LIMITS, DT, start))
        errors = [abs(state.s - r.s) for state, r in zip(states, reference, strict=True)]
        assert max(errors[:lost]) > 5e-3
        assert max(errors[met:]) < 1e-9


def test_known_future_is_used_to_arrive_earlier_than_without_it():
    reference = list(sine(0.15, 0.5, 200))
    one, many = (
        sum(abs(state.s - r.s) for state, r in zip(states, reference, strict=True))
        for states in (followed(reference, LineSmoother(LIMITS, DT, LineState(-0.05)), ahead) for ahead in (0, 50))
    )
    assert many <= one * 1.05


def test_a_far_step_is_reached_at_rest_near_the_speed_limit():
    smoother = LineSmoother(LIMITS, DT, LineState(-0.25))
    states = [smoother.update(LineState(0.54)) for _ in range(150)]
    s, v, _ = np.array(states).T
    assert states[-1] == pytest.approx((0.54, 0.0, 0.0), abs=1e-9)
    # Faster than the slowest place on the way would allow everywhere.
    assert np.argmax(np.abs(s - 0.54) < 1e-6) * DT < 1.2
    cruise = (s > 0.0) & (s < 0.45)
    assert np.min(v[cruise] / np.interp(s[cruise], LIMITS.s, LIMITS.speed)) > 0.9


LOST = [LineState(*(bad if k == at else 0.0 for k in range(3))) for bad in (math.nan, math.inf) for at in range(3)]


@pytest.mark.parametrize("lost", [*LOST, LineState(-math.inf), []])
def test_a_reference_that_is_none_brings_the_tool_to_rest(lost):
    reference = list(sine(0.15, 0.5, 60))
    smoother = LineSmoother(LIMITS, DT, reference[0])
    states = followed(reference, smoother) + [smoother.update(lost) for _ in range(60)]
    assert smoother.at_rest
    assert worst_excess(LIMITS, states) < 1e-9


def test_what_follows_a_nan_in_a_sequence_is_left_out():
    clean = list(sine(0.15, 0.5, 50))
    lost = [*clean[:20], LineState(math.nan), *clean[21:]]
    with_nan, without = (LineSmoother(LIMITS, DT, LineState(-0.1)) for _ in range(2))
    assert with_nan.update(lost) == without.update(clean[:20])


def test_stop_comes_to_rest_within_the_limits_from_full_speed_and_a_restart_carries_on():
    smoother = LineSmoother(LIMITS, DT, LineState(-0.25))
    states = [smoother.update(LineState(0.54)) for _ in range(50)]
    assert states[-1].v > 0.9
    states += [smoother.stop() for _ in range(40)]
    assert smoother.at_rest
    assert smoother.stop() == states[-1]
    assert worst_excess(LIMITS, states) < 1e-9
    smoother.reset(LineState(0.2, -0.6, 2.0))
    states = [smoother.state, *(smoother.update(LineState(5.0)) for _ in range(200))]
    assert states[-1] == pytest.approx((LIMITS.s_max, 0.0, 0.0), abs=1e-9)  # it stops at the end
    assert worst_excess(LIMITS, states) < 1e-9
    assert is_one_motion(states, LIMITS.jerk)


@pytest.mark.parametrize(
    "state",
    [(0.6,), (0.0, 1.5), (0.0, 0.0, 50.0), (0.545, 0.4), (math.nan,), (0.0, 1e300), (0.0, 0.0, math.inf)],
)
def test_a_start_that_cannot_be_stopped_within_the_limits_is_refused(state, complains):
    with complains(InputError):
        LineSmoother(LIMITS, DT, LineState(*state))


def test_no_intermediate_waypoint_which_ruckig_would_send_to_a_server_is_ever_used(monkeypatch):
    seen = []

    class Watched:
        def __init__(self, dofs: int) -> None:
            self._real = ruckig.Ruckig(dofs)

        def calculate(self, parameters: ruckig.InputParameter, trajectory: ruckig.Trajectory) -> object:
            seen.append(len(parameters.intermediate_positions))
            return self._real.calculate(parameters, trajectory)

    monkeypatch.setattr(planner, "ruckig", SimpleNamespace(**{**vars(ruckig), "Ruckig": Watched}))
    smoother = LineSmoother(LIMITS, DT, LineState(0.0))
    for target in (*sine(0.15, 0.5, 50), LineState(0.5), LineState(9.0), LineState(math.nan)):
        smoother.update(target)
    assert len(seen) > 100
    assert set(seen) == {0}


wild = st.floats(allow_nan=True, allow_infinity=True)
plain = st.floats(-1.0, 1.0)


@st.composite
def references(draw: st.DrawFn) -> list[LineState]:
    """Smooth, steps, chirps, noise and nonsense, one after the other."""
    out: list[LineState] = []
    for _ in range(draw(st.integers(1, 4))):
        kind = draw(st.sampled_from(["sine", "chirp", "step", "noise", "wild", "hold"]))
        count = draw(st.integers(1, 30))
        t = DT * np.arange(count)
        if kind == "sine":
            out += list(sine(draw(st.floats(0.0, 0.6)), draw(st.floats(0.0, 5.0)), count, draw(plain)))
        elif kind == "chirp":
            amplitude, rate = draw(st.floats(0.0, 0.5)), draw(st.floats(0.0, 60.0))
            s = amplitude * np.sin(rate * t**2)
            out += (
                [LineState(*map(float, r)) for r in zip(s, np.gradient(s, DT), 0 * t, strict=True)] if count > 1 else []
            )
        elif kind == "step":
            out += [LineState(draw(plain))] * count
        elif kind == "noise":
            scale = draw(st.tuples(st.floats(0.0, 2.0), st.floats(0.0, 5.0), st.floats(0.0, 50.0)))
            rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
            out += [LineState(*map(float, row)) for row in rng.normal(0.0, 1.0, (count, 3)) * scale]
        elif kind == "wild":
            out += [LineState(draw(wild), draw(wild), draw(wild)) for _ in range(min(count, 5))]
        else:
            out += [LineState(math.nan)] * count
    return out


@st.composite
def lines(draw: st.DrawFn) -> LineLimits:
    """Baxter's line, or one whose limits jump about from node to node."""
    if draw(st.booleans()):
        return LIMITS
    count = draw(st.integers(2, 12))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    s = np.sort(rng.uniform(-0.5, 0.5, count)) + 1e-3 * np.arange(count)
    return LineLimits(s, rng.uniform(0.2, 1.5, count), rng.uniform(3.0, 15.0, count), float(rng.uniform(50.0, 500.0)))


@settings(max_examples=50)
@given(limits=lines(), reference=references(), at=st.floats(0.0, 1.0), ahead=st.integers(0, 20))
def test_no_reference_makes_the_tool_exceed_a_limit(limits, reference, at, ahead):
    smoother = LineSmoother(limits, DT, LineState(limits.s_min + at * (limits.s_max - limits.s_min)))
    states = [smoother.state]
    for k in range(len(reference)):
        states.append(smoother.update(reference[k : k + ahead] if ahead else reference[k]))
        assert states[-1] == pytest.approx(smoother.motion.state_at(DT), abs=1e-9)
        assert worst_excess_between(limits, smoother.motion) < 1e-9
    states += [smoother.stop() for _ in range(5)]
    assert worst_excess(limits, states) < 1e-9
    assert is_one_motion(states, limits.jerk)
    for _ in range(300):
        smoother.stop()
    assert smoother.at_rest
