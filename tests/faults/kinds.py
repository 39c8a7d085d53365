"""What sensors may do, by name: the fault between two instants [s], and words that its reason holds where it lasts."""

import math

from faults.faulty import (
    BadForce,
    BadJoints,
    Frozen,
    Raises,
    Stale,
    Unplugged,
    one_joint_fewer,
    with_force,
    with_stamp,
    with_values,
)  # fmt: skip

NAN, INF = math.nan, math.inf


def cell(spoil):
    return lambda *when: BadForce(spoil, *when)


def joints(spoil):
    return lambda *when: BadJoints(spoil, *when)


SENSORS = {
    "force-nan": (cell(with_force(lambda _f: NAN)), "load cell .* NaN"),
    "force-inf": (cell(with_force(lambda _f: INF)), "load cell .* NaN or an infinity"),
    "force-jumps": (cell(with_force(lambda f: f + 5.0)), "load cell .* jumps farther"),
    "force-stamp-ahead": (cell(with_stamp(lambda t: t + 1000.0)), "load cell .* future"),
    "force-stamp-back": (cell(with_stamp(lambda t: t - 0.5)), "load cell .* not later"),
    "force-stamp-nan": (cell(with_stamp(lambda _t: NAN)), "load cell .* NaN"),
    "force-raises": (lambda *when: Raises("load_cell", OSError("port gone"), *when), "load cell .* cannot be read"),
    "q-nan": (joints(with_values("q", NAN)), "joints .* NaN"),
    "v-inf": (joints(with_values("v", INF)), "joints .* NaN or an infinity"),
    "tau-nan": (joints(with_values("tau", NAN)), "joints .* NaN"),
    "q-elsewhere": (joints(with_values("q", 0.0)), "joints .* jumps"),
    "v-huge": (joints(with_values("v", 50.0)), "joints .* out of range"),
    "joint-missing": (joints(one_joint_fewer), "joints .* wrong number"),
    "joint-stamp-ahead": (joints(with_stamp(lambda t: t + 1000.0)), "joints .* clock has jumped"),
    "joint-stamp-back": (joints(with_stamp(lambda t: t - 0.3)), "joints .* not later"),
    "joint-stamp-nan": (joints(with_stamp(lambda _t: NAN)), "joints .* NaN"),
    "joints-stale": (Stale, "joints .* not later"),
    "joints-raise": (lambda *when: Raises("joint_state", RuntimeError("bus"), *when), "joints .* cannot be read"),
}

DEAD_CELLS = {
    "cell-unplugged": (Unplugged, "load cell .* no sample"),
    "cell-frozen": (Frozen, "load cell .* repeated"),
    "cell-saturated": (cell(with_force(lambda _f: 9.80665)), "load cell .* (jumps farther|end of the cell's range)"),
}
"""Faults of the load cell that show only where they last."""
