"""What would tell tied effects apart."""

from collections.abc import Iterable, Sequence

from armdyn.run import Run

_WEIGH = 'weigh the load and state it (mass = "80 g +/- 0.4 g")'
_MEASURE = 'measure the string and state it (length = "0.368 m +/- 1 mm")'
_ANGLE = "add an angle sensor"
_OTHER_MASS = "record again with another load of known mass"
_RICHER = "record a richer motion: several frequencies, small and large swings"
_LEVEL = "level the line, or turn the robot round and record again"
_REST = "record the load cell at rest for a minute"

_GROUPS: tuple[tuple[frozenset[str], tuple[str, ...]], ...] = (
    (frozenset({"sensor_gain", "sensor_nonlinearity"}), (_WEIGH, _OTHER_MASS)),
    (frozenset({"load_inertia", "string_mass", "gripper_scale"}), (_WEIGH, _MEASURE, _OTHER_MASS)),
    (frozenset({"wind", "path_tilt"}), (_LEVEL,)),
    (
        frozenset({"pivot_viscous_friction", "pivot_coulomb_friction", "linear_drag", "quadratic_drag"}),
        (_ANGLE, _RICHER, _OTHER_MASS),
    ),
    (frozenset({"sensor_lag", "sensor_delay", "gripper_lag"}), (_ANGLE, "record a faster motion of the gripper")),
    (frozenset({"sensor_bias", "sensor_drift", "sensor_gain"}), (_REST, _WEIGH)),
    (frozenset({"string_elasticity", "gripper_compliance"}), (_ANGLE, _OTHER_MASS)),
    (frozenset({"link_inertia", "payload", "rotor_inertia", "gravity_spring", "torque_gain"}),
     ("record the arm in other postures and with faster motions", "record with a known payload and without")),
    (frozenset({"joint_viscous_friction", "joint_coulomb_friction", "joint_stribeck_friction", "joint_load_friction"}),
     ("record the joints at several constant speeds, slow ones too",)),
)  # fmt: skip


_OTHER_POSTURES = "record the arm in other postures and with faster motions"


def remedies(tied: Iterable[str], runs: Sequence[Run] = ()) -> tuple[str, ...]:
    """What to do so that the next runs tell these effects apart; nothing that was done for these runs."""
    names = set(tied)
    found: list[str] = []
    for group, advice in _GROUPS:
        if len(names & group) > 1:
            found += advice
    if not found:
        found = [_OTHER_POSTURES] if any(run.joints for run in runs) else [_RICHER, _ANGLE]
    fitting = tuple(dict.fromkeys(advice for advice in found if not _done(advice, runs)))
    return fitting or ((_OTHER_POSTURES,) if any(run.joints for run in runs) else (_RICHER,))


def _done(advice: str, runs: Sequence[Run]) -> bool:
    """Whether all runs have what is advised, or cannot have it."""
    if not runs:
        return False
    measured = set.intersection(*(set(run.measured) for run in runs))
    known = set.intersection(*(set(run.known) for run in runs))
    return (
        (advice == _ANGLE and bool({"swing_angle", "swing_rate"} & measured))
        or (advice == _REST and "load_force" not in measured)
        or (advice == _WEIGH and "mass" in known)
        or (advice == _MEASURE and "length" in known)
    )
