"""Effects of a force/torque sensor: mechanics of its mounting first, then its electronics.

In the equations f and t are the force and the torque on the sensor, in the axes of its frame.
"""

import casadi as ca
import numpy as np

from armdyn.arm.physics import Expression, Wrench
from armdyn.effects.effect import effect
from armdyn.parameter import quantity

HALF_TURN = np.pi


@effect(
    summary="A cable or a hose pulls at what the sensor carries, with a constant force.",
    source="a force at a point of a body: Siciliano, Sciavicco, Villani & Oriolo, Robotics, 2009, §7.1",
)
def cable_pull(
    wrench: Wrench,
    x: Expression = quantity("N", typical=5.0, summary="force along the x axis of the base"),
    y: Expression = quantity("N", typical=5.0, summary="force along the y axis of the base"),
    z: Expression = quantity("N", typical=5.0, summary="force along the z axis of the base"),
    at_x: Expression = quantity("m", typical=0.1, spread=0.2, summary="where it pulls, in the frame of the sensor"),
    at_y: Expression = quantity("m", typical=0.1, spread=0.2, summary="where it pulls, in the frame of the sensor"),
    at_z: Expression = quantity("m", typical=0.1, spread=0.2, summary="where it pulls, in the frame of the sensor"),
) -> Wrench:
    """Force f + R F and torque t + p x R F, with the pull F in the base's axes and R from these to the sensor's."""
    pull = wrench.axes @ ca.vertcat(x, y, z)
    return wrench.with_wrench(pull, ca.cross(ca.vertcat(at_x, at_y, at_z), pull))


@effect(
    summary="The axes of the sensor are turned against the frame that the model states.",
    source="rotation by roll, pitch and yaw: Siciliano, Sciavicco, Villani & Oriolo, Robotics, 2009, §2.4.2",
)
def wrench_rotation(
    wrench: Wrench,
    roll: Expression = quantity(
        "rad", typical=0.1, lower=-HALF_TURN, upper=HALF_TURN, summary="of the sensor about its x axis"
    ),
    pitch: Expression = quantity(
        "rad", typical=0.1, lower=-HALF_TURN, upper=HALF_TURN, summary="then about the stated y axis"
    ),
    yaw: Expression = quantity(
        "rad", typical=0.1, lower=-HALF_TURN, upper=HALF_TURN, summary="then about the stated z axis"
    ),
) -> Wrench:
    """Force R' f and torque R' t, R = R_z(yaw) R_y(pitch) R_x(roll)."""
    R = ca.SX.eye(3)
    for angle, (i, j) in ((roll, (1, 2)), (pitch, (2, 0)), (yaw, (0, 1))):
        turn = ca.SX.eye(3)
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = ca.cos(angle), -ca.sin(angle), ca.sin(angle), ca.cos(angle)
        R = turn @ R
    return wrench.mixed(ca.diagcat(R.T, R.T))


@effect(
    summary="Each axis of the sensor also reads a share of the others: its calibration matrix is wrong.",
    source="cross-talk of multi-axis sensors: ISO/TS 17915; Bicchi, IEEE T-RA 8(6), 1992",
)
def wrench_crosstalk(
    wrench: Wrench,
    fx_fy: Expression = quantity("1", typical=0.02, spread=0.1, summary="reading fx per force fy"),
    fx_fz: Expression = quantity("1", typical=0.02, spread=0.1, summary="reading fx per force fz"),
    fy_fx: Expression = quantity("1", typical=0.02, spread=0.1, summary="reading fy per force fx"),
    fy_fz: Expression = quantity("1", typical=0.02, spread=0.1, summary="reading fy per force fz"),
    fz_fx: Expression = quantity("1", typical=0.02, spread=0.1, summary="reading fz per force fx"),
    fz_fy: Expression = quantity("1", typical=0.02, spread=0.1, summary="reading fz per force fy"),
    tx_fx: Expression = quantity("m", typical=0.002, spread=0.01, summary="reading tx per force fx"),
    tx_fy: Expression = quantity("m", typical=0.002, spread=0.01, summary="reading tx per force fy"),
    tx_fz: Expression = quantity("m", typical=0.002, spread=0.01, summary="reading tx per force fz"),
    ty_fx: Expression = quantity("m", typical=0.002, spread=0.01, summary="reading ty per force fx"),
    ty_fy: Expression = quantity("m", typical=0.002, spread=0.01, summary="reading ty per force fy"),
    ty_fz: Expression = quantity("m", typical=0.002, spread=0.01, summary="reading ty per force fz"),
    tz_fx: Expression = quantity("m", typical=0.002, spread=0.01, summary="reading tz per force fx"),
    tz_fy: Expression = quantity("m", typical=0.002, spread=0.01, summary="reading tz per force fy"),
    tz_fz: Expression = quantity("m", typical=0.002, spread=0.01, summary="reading tz per force fz"),
) -> Wrench:
    """Force f + C f and torque t + K f, C without a diagonal."""
    C = ca.vertcat(ca.horzcat(0, fx_fy, fx_fz), ca.horzcat(fy_fx, 0, fy_fz), ca.horzcat(fz_fx, fz_fy, 0))
    K = ca.vertcat(ca.horzcat(tx_fx, tx_fy, tx_fz), ca.horzcat(ty_fx, ty_fy, ty_fz), ca.horzcat(tz_fx, tz_fy, tz_fz))
    return wrench.with_wrench(C @ wrench.force, K @ wrench.force)


@effect(
    summary="Axes of the sensor are wrong by a constant share.",
    source="sensitivity error: JCGM 200 (VIM), §4.12",
)
def wrench_gain(
    wrench: Wrench,
    fx: Expression = quantity("1", typical=0.03, lower=-0.9, upper=10.0, spread=0.3, summary="relative error of fx"),
    fy: Expression = quantity("1", typical=0.03, lower=-0.9, upper=10.0, spread=0.3, summary="relative error of fy"),
    fz: Expression = quantity("1", typical=0.03, lower=-0.9, upper=10.0, spread=0.3, summary="relative error of fz"),
    tx: Expression = quantity("1", typical=0.03, lower=-0.9, upper=10.0, spread=0.3, summary="relative error of tx"),
    ty: Expression = quantity("1", typical=0.03, lower=-0.9, upper=10.0, spread=0.3, summary="relative error of ty"),
    tz: Expression = quantity("1", typical=0.03, lower=-0.9, upper=10.0, spread=0.3, summary="relative error of tz"),
) -> Wrench:
    """Reading (1 + e) of each axis of f and t."""
    return wrench.mixed(ca.diag(1 + ca.vertcat(fx, fy, fz, tx, ty, tz)))


@effect(
    summary="The sensor reads constants too much, as after zeroing with a tool.",
    source="offset error: JCGM 200 (VIM), §4.20",
)
def wrench_offset(
    wrench: Wrench,
    fx: Expression = quantity("N", typical=5.0, summary="reading fx without a force"),
    fy: Expression = quantity("N", typical=5.0, summary="reading fy without a force"),
    fz: Expression = quantity("N", typical=5.0, summary="reading fz without a force"),
    tx: Expression = quantity("N m", typical=0.5, summary="reading tx without a torque"),
    ty: Expression = quantity("N m", typical=0.5, summary="reading ty without a torque"),
    tz: Expression = quantity("N m", typical=0.5, summary="reading tz without a torque"),
) -> Wrench:
    """Force f + a and torque t + b, with constants a and b."""
    return wrench.with_wrench(ca.vertcat(fx, fy, fz), ca.vertcat(tx, ty, tz))


@effect(
    summary="The sensor's offsets drift at a constant rate, as while it warms up.",
    source="instrumental drift: JCGM 200 (VIM), §4.21",
)
def wrench_drift(
    wrench: Wrench,
    fx: Expression = quantity("N/s", typical=0.02, summary="rate of reading fx"),
    fy: Expression = quantity("N/s", typical=0.02, summary="rate of reading fy"),
    fz: Expression = quantity("N/s", typical=0.02, summary="rate of reading fz"),
    tx: Expression = quantity("N m/s", typical=0.002, summary="rate of reading tx"),
    ty: Expression = quantity("N m/s", typical=0.002, summary="rate of reading ty"),
    tz: Expression = quantity("N m/s", typical=0.002, summary="rate of reading tz"),
) -> Wrench:
    """Force f + a s and torque t + b s at the time s since the start of the run, with constants a and b."""
    return wrench.with_wrench(wrench.time * ca.vertcat(fx, fy, fz), wrench.time * ca.vertcat(tx, ty, tz))


@effect(
    summary="The readings of the sensor arrive late by a constant time, as behind a filter.",
    source="pure dead time: Åström & Murray, Feedback Systems, 2008, §9.2",
)
def wrench_delay(
    wrench: Wrench,
    time: Expression = quantity("s", typical=0.01, lower=0.0, upper=0.5, summary="delay"),
) -> Wrench:
    """Reading(s) = f(s - T), t(s - T)."""
    return wrench.with_delay(time)
