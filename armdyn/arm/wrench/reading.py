"""What a force/torque sensor with effects reads of a wrench, as functions of one axis each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import casadi as ca
import numpy as np

from armdyn.arm.composition import VectorisedExpression
from armdyn.arm.physics import Expression, Wrench
from armdyn.arm.wrench.sensor import WRENCH_AXES, WrenchAxes
from armdyn.effects.catalogue import catalogue_order
from armdyn.effects.effect import Effect, recorded_columns
from armdyn.errors import InputError
from armdyn.parameter import RecordedColumn
from armdyn.readout import SensorReadout

WRENCH_INPUT_SIZES = (1, 9, 3, len(WRENCH_AXES))
"""Number of inputs: time, rotation from the base to the sensor column by column, position, and wrench."""


@dataclass(frozen=True, eq=False)
class WrenchReading:
    """Reading of a sensor with its effects.

    Attributes:
        names: ``"<effect>.<quantity>"`` in the order of theta (k,).
        axes: by axis, (1 + k + 6,) reading, and its derivatives by theta and by the wrench, of (19 + c,) inputs.
        readout: delay of the reading.
        recorded: c recorded quantities that the effects read.
    """

    names: tuple[str, ...]
    axes: tuple[VectorisedExpression, ...]
    readout: SensorReadout
    recorded: tuple[RecordedColumn, ...]


def read_wrench(
    effects: Sequence[Effect],
    along: WrenchAxes,
    wrench: Wrench,
    parameters: Mapping[str, Expression],
    recorded: Mapping[RecordedColumn, Expression] = MappingProxyType({}),
) -> Wrench:
    """The wrench that a sensor reads along these axes, with effects in the catalogue's order; see `Effect.apply`."""
    for e in catalogue_order(effects):
        wrench = e.apply(wrench, parameters, recorded)
    return wrench if along is WrenchAxes.SENSOR else wrench.mixed(ca.diagcat(wrench.axes.T, wrench.axes.T))


def wrench_reading(effects: Sequence[Effect], axes: WrenchAxes = WrenchAxes.SENSOR) -> WrenchReading:
    """Apply effects to a sensor, whose channels are along these axes.

    Raises:
        InputError: an effect lets the delay change with the motion.
    """
    return _composed(tuple(e.on() for e in effects), axes)


@lru_cache(maxsize=256)
def _composed(effects: tuple[Effect, ...], along: WrenchAxes) -> WrenchReading:
    names = tuple(f"{e.name}.{short}" for e in effects for short in e.quantities)
    theta, columns = ca.SX.sym("theta", len(names)), recorded_columns(effects)
    inputs = ca.SX.sym("w", sum(WRENCH_INPUT_SIZES) + len(columns))
    time, axes, place, true, further = ca.vertsplit(
        inputs, [0, *np.cumsum(WRENCH_INPUT_SIZES).tolist(), inputs.numel()]
    )
    given = dict(zip(names, ca.vertsplit(theta), strict=True)) if names else {}
    recorded = dict(zip(columns, ca.vertsplit(further), strict=True)) if columns else {}
    wrench = Wrench(time, ca.reshape(axes, 3, 3), place, *ca.vertsplit(true, 3))
    wrench = read_wrench(effects, along, wrench, given, recorded)
    if ca.depends_on(wrench.delay, inputs):
        raise InputError(
            f"effects {', '.join(e.name for e in effects)}: the delay of a wrench can depend on parameters only"
        )
    reading = ca.vertcat(wrench.force, wrench.torque)
    derivatives = ca.densify(ca.horzcat(reading, ca.jacobian(reading, theta), ca.jacobian(reading, true)))
    rows = tuple(VectorisedExpression(row.T, inputs, theta) for row in ca.vertsplit(derivatives))
    return WrenchReading(names, rows, SensorReadout(theta, 1, 0, wrench.delay), columns)
