"""Smoothing side by side: next-sample ruckig, look-ahead ruckig, the offline program, and toppra for the finish.

Deviation, lag, broken limits and time per update on references that are feasible and on others that are not. Times are
ratios to plain next-sample ruckig in the same run, interleaved.

    python benchmarks/rivals/smoothing.py [--repeat 5]
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _timing as bench  # isort: skip

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import ruckig

import ik
import urdf
from pipeline.motion import LineLimits, LineSmoother, LineState, motion_to_finish_over_box
from pipeline.motion.finish import MAX_FINISH_ACCELERATION, MAX_FINISH_SHARE_OF_SPEED_LIMIT
from pipeline.motion.reference import smooth_reference

DT = 0.01
AHEAD = 50
"""Number of future samples that the look-ahead scheme receives where they are known."""

Array = np.ndarray


@dataclass(frozen=True)
class Reference:
    """Desired positions, speeds and accelerations, and whether the limits permit them."""

    name: str
    feasible: bool
    s: Array
    v: Array
    a: Array


def references() -> list[Reference]:
    t = DT * np.arange(401)
    rng = np.random.default_rng(0)
    ramp = np.clip(t / 0.5, 0.0, 1.0)
    smooth = ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)
    return [
        _reference("sine 0.15 m, 0.5 Hz", True, 0.15 * np.sin(2 * np.pi * 0.5 * t) * smooth),
        _multisine("multisine to 1.5 Hz, joined on the way", t, rng),
        _reference("sine 0.30 m, 0.8 Hz (too fast)", False, 0.30 * np.sin(2 * np.pi * 0.8 * t)),
        _reference("steps of 0.2 m", False, 0.2 * np.sign(np.sin(2 * np.pi * 0.5 * t + 0.1))),
        _reference("chirp to 3 Hz, 0.1 m", False, 0.1 * np.sin(2 * np.pi * 0.375 * t**2)),
        _reference("beyond both ends", False, 0.8 * np.sin(2 * np.pi * 0.25 * t)),
        _reference("noise of 0.1 m", False, rng.normal(0.0, 0.1, t.size)),
    ]


def next_sample(reference: Reference, limits: LineLimits, speed: float, acceleration: float) -> Array:
    """Motion by ruckig from sample to sample, as its users write it."""
    otg, trajectory, p = ruckig.Ruckig(1), ruckig.Trajectory(1), ruckig.InputParameter(1)
    p.max_velocity, p.max_acceleration, p.max_jerk = [speed], [acceleration], [limits.jerk]
    p.minimum_duration = DT
    state = (float(np.clip(reference.s[0], limits.s_min, limits.s_max)), 0.0, 0.0)
    out = [state]
    for k in range(1, reference.s.size):
        p.current_position, p.current_velocity, p.current_acceleration = ([x] for x in state)
        p.target_position = [float(np.clip(reference.s[k], limits.s_min, limits.s_max))]
        p.target_velocity = [float(np.clip(reference.v[k], -0.99 * speed, 0.99 * speed))]
        p.target_acceleration = [float(np.clip(reference.a[k], -0.99 * acceleration, 0.99 * acceleration))]
        try:
            otg.calculate(p, trajectory)
            state = tuple(x[0] for x in trajectory.at_time(DT))
        except ruckig.RuckigError:
            # A target that no motion within the limits passes through: its users keep the last trajectory.
            state = tuple(x[0] for x in trajectory.at_time(2 * DT))
        out.append(state)
    return np.array(out)


def look_ahead(reference: Reference, limits: LineLimits, ahead: int) -> Array:
    targets = [LineState(*map(float, row)) for row in zip(reference.s, reference.v, reference.a, strict=True)]
    smoother = LineSmoother(limits, DT, LineState(float(np.clip(reference.s[0], limits.s_min, limits.s_max))))
    states = [smoother.state]
    for k in range(1, len(targets)):
        states.append(smoother.update(targets[k : k + ahead] if ahead > 1 else targets[k]))
    return np.array(states)


def program(reference: Reference, limits: LineLimits) -> Array:
    start = LineState(float(np.clip(reference.s[0], limits.s_min, limits.s_max)))
    return np.array(list(smooth_reference(reference.s, reference.v, DT, limits, start=start)))


def lag(reference: Reference, motion: Array) -> float:
    """Delay with the smallest difference of motion and reference [s]."""
    wanted = np.clip(reference.s, motion[:, 0].min(), motion[:, 0].max())
    shifts = range(41)
    apart = [np.mean((motion[k:, 0] - wanted[: wanted.size - k]) ** 2) for k in shifts]
    return DT * int(np.argmin(apart))


def broken(motion: Array, limits: LineLimits) -> int:
    """Number of samples that exceed a limit by more than 1e-9."""
    s, v, a = motion.T
    beyond = (np.abs(v) > limits.speed_at(s) + 1e-9) | (np.abs(a) > limits.acceleration_at(s) + 1e-9)
    beyond |= (s < limits.s_min - 1e-9) | (s > limits.s_max + 1e-9)
    beyond[1:] |= np.abs(np.diff(a)) > DT * limits.jerk + 1e-9
    return int(np.sum(beyond))


def compare(limits: LineLimits, repeat: int) -> None:
    fastest = float(limits.speed.max()), float(limits.acceleration.max())
    slowest = float(limits.speed.min()), float(limits.acceleration.min())
    schemes: list[tuple[str, Callable[[Reference], Array]]] = [
        ("next sample, limits of the fastest place", lambda r: next_sample(r, limits, *fastest)),
        ("next sample, limits of the slowest place", lambda r: next_sample(r, limits, *slowest)),
        ("look-ahead, present reference only", lambda r: look_ahead(r, limits, 1)),
        ("look-ahead, 0.5 s of the future", lambda r: look_ahead(r, limits, AHEAD)),
        ("offline program", lambda r: program(r, limits)),
    ]
    for reference in references():
        motions = {name: scheme(reference) for name, scheme in schemes}
        seconds = bench.race({name: bench.timed(partial(scheme, reference)) for name, scheme in schemes}, repeat)
        print(f"\n{reference.name} ({'feasible' if reference.feasible else 'infeasible'})")
        print(f"  {'':42} {'rms':>8} {'largest':>8} {'lag':>6} {'broken':>7} {'time':>7}")
        print(f"  {'':42} {'[mm]':>8} {'[mm]':>8} {'[ms]':>6} {'samples':>7} {'ratio':>7}")
        for name, _ in schemes:
            apart = 1e3 * (motions[name][:, 0] - reference.s)
            print(
                f"  {name:42} {np.sqrt(np.mean(apart**2)):8.2f} {np.max(np.abs(apart)):8.2f} "
                f"{1e3 * lag(reference, motions[name]):6.0f} {broken(motions[name], limits):7d} "
                f"{bench.ratio(seconds, name, schemes[0][0]).median:7.1f}"
            )


def finish(limits: LineLimits) -> None:
    """Print the durations of the move over the box, from rest at s = 0.13 m to s = 0.46 m, under the same limits."""
    begin, end = 0.13, 0.46
    share = MAX_FINISH_SHARE_OF_SPEED_LIMIT
    ours = motion_to_finish_over_box(LineState(begin), end, limits, 1e-3).time[-1]
    inside = (limits.s >= begin) & (limits.s <= end)
    otg, trajectory, p = ruckig.Ruckig(1), ruckig.Trajectory(1), ruckig.InputParameter(1)
    p.current_position, p.target_position = [begin], [end]
    p.max_velocity = [share * float(limits.speed[inside].min())]
    strength = min(MAX_FINISH_ACCELERATION, float(limits.acceleration[inside].min()))
    p.max_acceleration, p.max_jerk = [strength], [limits.jerk]
    otg.calculate(p, trajectory)
    print("\nfinish over the box, s = 0.13 to 0.46 m, at 0.70 of the speed limit")
    print(f"  riding the limit            {ours:.3f} s")
    print(f"  ruckig, constant limits     {trajectory.duration:.3f} s ({trajectory.duration / ours:.2f} times)")
    again = _toppra(limits, begin, end)
    print(
        f"  toppra, no limit of jerk    {again:.3f} s ({again / ours:.2f} times)"
        if again
        else "  toppra is not installed"
    )


def _toppra(limits: LineLimits, begin: float, end: float) -> float | None:
    try:
        import toppra
        from toppra import algorithm, constraint
    except ImportError:
        return None
    toppra.setup_logging("ERROR")
    path = toppra.SplineInterpolator([0.0, 1.0], np.array([[begin], [end]]))

    def speed(x: float) -> Array:
        v = MAX_FINISH_SHARE_OF_SPEED_LIMIT * float(limits.speed_at(path(x)[0]))
        return np.array([[-v, v]])

    def strength(x: float) -> float:
        return min(MAX_FINISH_ACCELERATION, float(limits.acceleration_at(path(x)[0])))

    weakest = min(strength(x) for x in np.linspace(0.0, 1.0, 50))
    constraints = [
        constraint.JointVelocityConstraintVarying(speed),
        constraint.JointAccelerationConstraint(np.array([[-weakest, weakest]])),
    ]
    retimed = algorithm.TOPPRA(constraints, path, gridpoints=np.linspace(0.0, 1.0, 400)).compute_trajectory()
    return None if retimed is None else float(retimed.duration)


def _reference(name: str, feasible: bool, s: Array) -> Reference:
    v = np.gradient(s, DT)
    return Reference(name, feasible, s, v, np.gradient(v, DT))


def _multisine(name: str, t: Array, rng: np.random.Generator) -> Reference:
    """Multisine as broad in frequency as SAC's motions, with known acceleration, in motion at its first sample."""
    w, phase = 2 * np.pi * np.linspace(0.3, 1.5, 6)[:, None], rng.uniform(0.0, 2 * np.pi, (6, 1))
    size = 0.02 / np.linspace(1.0, 3.0, 6)[:, None]
    s, v, a = size * np.sin(w * t + phase), size * w * np.cos(w * t + phase), -size * w**2 * np.sin(w * t + phase)
    return Reference(name, True, s.sum(axis=0), v.sum(axis=0), a.sum(axis=0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=3, help="rounds of turns; the median ratio counts")
    repeat = parser.parse_args().repeat
    limits = LineLimits.from_table(ik.default_table(urdf.load("baxter")))
    compare(limits, repeat)
    finish(limits)


if __name__ == "__main__":
    main()
