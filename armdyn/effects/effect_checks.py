"""Check a user's effect when its file is read, so that a mistake gives one clear sentence instead of a failed fit.

The declaration is checked first (name, units, sizes). Then the effect is applied to a stage of the same kind as in the
equations, at rest and in motion, at its null values and at its typical values.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from armdyn.arm.physics import Base, DriveCommands, Joint, Link, Neighbour, Wrench
from armdyn.effects.effect import Effect
from armdyn.errors import ArmdynError, InputError
from armdyn.parameter import Quantity, RecordedColumn
from armdyn.pendulum.physics import Gripper, Load, Sensor, String, Tension
from armdyn.physics.definition import AddedState, Expression
from armdyn.recording.channels import is_auxiliary
from armdyn.recording.units import si_unit, to_base_units
from armdyn.user_code import error_line

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,59}")
LARGEST_VALUE = 1e100
"""Largest finite value or bound of a quantity: larger numbers overflow in the equations."""


def check_declared(effects: Sequence[Effect], path: Path) -> None:
    """Check the names, units and sizes that the effects of a file declare.

    Raises:
        InputError: a declaration is wrong; the message names the file, its line, the mistake and a remedy.
    """
    seen: dict[str, Effect] = {}
    for item in effects:
        if not isinstance(item.name, str) or not _NAME.fullmatch(item.name):
            raise _fault(item, path, "its name is not made of letters, digits and '_', a letter first: rename it")
        if seen.setdefault(item.name, item) is not item:
            raise _fault(item, path, "another effect of this file has the same name: rename one")
        for what in ("acts_on", "summary", "source"):
            if not isinstance(getattr(item, what), str):
                raise _fault(item, path, f"{what} is not a text: put it in quotes")
        for short, declared in item.quantities.items():
            wrong = _wrong_with(declared, of_catalogue=item.acts_on in TRIAL_STAGES)
            if wrong is not None:
                raise _fault(item, path, f"'{short}': {wrong}")
        for argument, column in item.columns.items():
            wrong = "the base stands still: let a joint read it" if item.reach == "base" else _wrong_with_column(column)
            if wrong is not None:
                raise _fault(item, path, f"'{argument}': {wrong}")


def check_applied(item: Effect, path: Path) -> None:
    """Check an effect by applying it to a stage, at rest and in motion; other stages than `TRIAL_STAGES` are skipped.

    Raises:
        InputError: the effect fails, changes something at its null values, or gives no finite value or derivative.
    """
    stage = TRIAL_STAGES.get("base" if (item.acts_on, item.reach) == ("joint", "base") else item.acts_on)
    if stage is None:
        return
    build, *points = stage
    inputs = ca.SX.sym("w", len(points[0]))
    given = build(*ca.vertsplit(inputs))
    theta = ca.SX.sym("theta", len(item.quantities))
    try:
        arguments = dict(zip(item.quantities, ca.vertsplit(theta), strict=True))
        arguments |= {name: column.usual for name, column in item.columns.items()}
        changed = item.function(given, **arguments)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a user's function may raise any error; the remedy is in their file
        raise _fault(item, path, _why(error), error) from error
    if not isinstance(changed, type(given)):
        kind = type(changed).__name__
        raise _fault(item, path, f"it returns a {kind}: return the {item.acts_on} that it was given, with changes")
    before, after = _expressions(given), _expressions(changed)
    brought = getattr(changed, "added_states", ())
    remembered = ca.vertcat(ca.SX(0, 1), *(m.symbol for m in brought))
    try:
        difference = ca.densify(ca.vertcat(*(a - b for a, b in zip(after, before, strict=True))))
        rates = ca.vertcat(ca.SX(0, 1), *(ca.vertcat(m.rate, m.start) for m in brought))
        everything = ca.densify(ca.vertcat(*after, rates))
        slopes, along = ca.jacobian(everything, theta), ca.jacobian(everything, inputs)
        evaluate = ca.Function("applied", [inputs, theta, remembered], [difference, everything, slopes, along])
    except (RuntimeError, TypeError, ValueError, NotImplementedError) as error:
        raise _fault(item, path, "it makes something of another shape, or of symbols of its own: correct it") from error
    null = [q.null for q in item.quantities.values()]
    typical = [float(np.clip(q.null + q.typical, q.lower, q.upper)) for q in item.quantities.values()]
    for where, point in zip((AT_REST, MOVING), points, strict=True):
        for at, values in (("null", null), ("typical", typical)):
            found = [np.asarray(x.full()) for x in evaluate(point, values, np.zeros(remembered.numel()))]
            change, value, by_theta, by_inputs = found
            if not np.isfinite(value).all():
                hint = "write it with casadi, such as ca.sin, and without a division by zero"
                raise _fault(item, path, f"it is not finite at its {at} values {where}: {hint}")
            if at == "null" and np.any(change != 0.0):
                raise _fault(item, path, "it changes something at its null values: make it vanish there")
            # At rest a force may have a corner in the motion, but its dependence on the parameters must be smooth.
            if not np.isfinite(by_theta).all() or (where == MOVING and not np.isfinite(by_inputs).all()):
                hint = "its derivative is infinite: move the null value, or add a small number below the root"
                raise _fault(item, path, f"it has no finite derivative at its {at} values {where}: {hint}")


def _wrong_with(q: Quantity, *, of_catalogue: bool) -> str | None:
    """Sentence on what is wrong with a parameter's declaration; None where nothing is.

    The catalogue's stages are in SI units; those of a user's own base are in the units that the base has.
    """
    for what in ("typical", "null", "lower", "upper"):
        value = getattr(q, what)
        if not _is_number(value):
            return f"{what} is {value!r:.60}: write a number"
    if not isinstance(q.unit, str):
        return f"unit is {q.unit!r}: write a text such as 'N s/m'"
    try:
        si = si_unit(q.unit) if of_catalogue else to_base_units(q.unit)[0]
    except InputError as error:
        return str(error)
    spread_fits = q.spread is None or (isinstance(q.spread, int | float) and 0.0 < q.spread < math.inf)
    faults = (
        (
            not 0.0 < q.typical < math.inf,
            f"typical is {q.typical:g}: write the size that it has in nature, more than 0",
        ),
        (
            not (q.lower <= q.null <= q.upper and math.isfinite(q.null)),
            f"null is {q.null:g}, outside {q.lower:g} to {q.upper:g}: widen the range",
        ),
        (q.lower == q.upper, "lower and upper are the same: leave it out, or widen the range"),
        (q.scope not in ("shared", "per_run"), f"scope is {q.scope!r}: write 'shared' or 'per_run'"),
        (not spread_fits, f"spread is {q.spread!r}: write a number of more than 0, or leave it out"),
        (
            of_catalogue and si.replace(" ", "") != q.unit.replace(" ", "") and q.unit != "Nm",
            f"'{q.unit}' is not an SI unit: write '{si}' and the numbers in it",
        ),
    )
    return next((said for wrong, said in faults if wrong), None)


def _wrong_with_column(column: RecordedColumn) -> str | None:
    """Sentence on what is wrong with a recorded quantity's declaration; None where nothing is."""
    if not (isinstance(column.name, str) and is_auxiliary(column.name)):
        return f"its column is {column.name!r:.60}: write a name such as 'extra.temperature'"
    if not _is_number(column.usual) or not math.isfinite(column.usual):
        return f"usual = {column.usual!r:.60} is not a number: give the value where it was not recorded"
    try:
        base = to_base_units(column.unit) if isinstance(column.unit, str) else None
    except InputError as error:
        return str(error)
    if base is None or base[1:] != (1.0, 0.0):
        return f"unit is {column.unit!r:.60}: write it in SI base units, such as {'K' if base is None else base[0]!r}"
    return None


def _is_number(value: object) -> bool:
    """Whether a value is a number that is not too large for a float."""
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and (value == value and (abs(value) <= LARGEST_VALUE or abs(value) == math.inf))
    )


AT_REST, MOVING = "at rest", "in motion"
"""Words in messages for the two states in which an effect is checked."""


def _joint(*w: Expression) -> Joint:
    link = Link(ca.SX(np.diag([0.1, 0.1, 0.1, 1.0])), ca.SX(4, 4))
    time, q, v, a, direction, load, inner_q, inner_v, inner_a, on, *told = w
    inner = Neighbour(inner_q, inner_v, inner_a)
    return Joint(time, q, v, a, direction, load, inner, link, on=on, told=DriveCommands(*told))


def _wrench(*w: Expression) -> Wrench:
    time, axes, place, force, torque = ca.vertsplit(ca.vertcat(*w), [0, 1, 10, 13, 16, 19])
    return Wrench(time, ca.reshape(axes, 3, 3), place, force, torque)


_AT_REST = [0.0] * 15
_IN_MOTION = [0.7, 0.4, -0.8, 0.5, -1.0, 3.0, 0.2, 0.3, -0.6, 1.0, 3.2, -0.5, 1.3, -0.7, -0.1]
TRIAL_STAGES: Mapping[str, tuple[Callable[..., Any], list[float], list[float]]] = {
    "gripper": (
        lambda t, x, v, z, phi: Gripper(t, x, v, z, phi, ca.vertcat(x, 0, z)),
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [0.7, 0.1, -0.3, 0.02, 0.2],
    ),
    "string": (String, [0.0, 0.0, 0.0, 0.08, 0.37, 9.81], [0.7, 0.2, -0.9, 0.08, 0.37, 9.8]),
    "load": (
        lambda t, m, x, y, z, u, v, w, phi, rate: Load(t, m, ca.vertcat(x, y, z), ca.vertcat(u, v, w), phi, rate),
        [0.0, 0.08, 0.0, 0.0, -0.37, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.7, 0.08, 0.03, 0.0, -0.36, -0.2, 0.0, 0.03, 0.2, -0.9],
    ),
    "tension": (Tension, [0.785, 0.0, 0.0, 0.08, 0.37, 0.0, 9.81], [0.82, 0.2, -0.9, 0.08, 0.37, 0.4, 9.8]),
    "sensor": (
        lambda t, tension, phi, rate: Sensor(t, tension, phi, tension, phi, rate),
        [0.0, 0.785, 0.0, 0.0],
        [0.7, 0.82, 0.2, -0.9],
    ),
    "joint": (_joint, _AT_REST, _IN_MOTION),
    "drive": (_joint, _AT_REST, _IN_MOTION),
    "wrench": (
        _wrench,
        [0.0, *np.eye(3).ravel(), *np.zeros(3), 0.0, 0.0, -9.81, 0.0, 0.0, 0.0],
        [0.7, 0.6, 0.8, 0.0, -0.8, 0.6, 0.0, 0.0, 0.0, 1.0, 0.3, 0.1, 0.6, 1.0, -2.0, -9.0, 0.3, 0.2, -0.1],
    ),
    "base": (lambda x, y, z: Base(ca.vertcat(x, y, z)), [0.0, 0.0, -9.81], [0.3, -0.2, -9.8]),
}
"""By name of the stage: the function that makes a stage from numbers, then its numbers at rest and in motion."""


def _expressions(stage: Any) -> list[Expression]:
    """Expressions of a stage as columns, without the states that effects add."""
    found: list[Expression] = []
    for each in fields(stage):
        value = getattr(stage, each.name)
        if isinstance(value, Link):
            found.append(ca.reshape(value.pseudo_inertia, -1, 1))
        elif isinstance(value, AddedState | tuple):
            continue
        elif is_dataclass(value):
            found += _expressions(value)
        else:
            found.append(ca.reshape(ca.densify(ca.SX(value)), -1, 1))
    return found


def _why(error: BaseException) -> str:
    text = " ".join(str(error).split())
    if isinstance(error, ArmdynError):
        return str(error)
    if "truth value" in text:
        return (
            "it asks 'if', 'and', 'max' or the like of a quantity that has no value yet: write ca.if_else(when, a, b)"
        )
    if isinstance(error, SystemExit):
        return "it calls sys.exit: raise an exception instead"
    return f"it fails with {': '.join(filter(None, [type(error).__name__, text[:200]]))}: correct its file"


def _fault(item: Effect, path: Path, what: str, error: BaseException | None = None) -> InputError:
    place = error_line(error, path)
    code = getattr(item.function, "__code__", None)
    if place == str(path) and code is not None and Path(code.co_filename) == path.absolute():
        place = f"{path}, line {code.co_firstlineno}"
    return InputError(f"{place}: the effect '{str(item.name)[:60]}': {what}")
