"""Which changes of an arm a watch tells: of the load at its tool, of sensors' offsets, and of effects in each joint.

Whether a watch can tell an effect is read from its equation: a joint's torque, or its reading, must depend on a
quantity linearly, by a factor that the motion alone gives. This factor is the quantity's column.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.arm.slots import DAMPING, FRICTION, GAIN, OFFSET, simplest_effect, slots_of
from armdyn.arm.symbolic import rigid_torques, torques_added_by_effects
from armdyn.arm.wrench.symbolic import sensor_reading
from armdyn.codegen import PreallocatedFunction, compile_functions
from armdyn.effects.effect import Effect
from armdyn.effects.wrench import wrench_offset
from armdyn.errors import InputError
from armdyn.estimation.posterior import NormalPrior
from armdyn.watch.channels import WatchedChannels
from armdyn.watch.observer import predicted_reading, without_past_dependent_effects

USUAL_CHANGES = tuple(simplest_effect(slot) for slot in (FRICTION, DAMPING, OFFSET, GAIN))
"""Effects that are watched in every joint: what wears, warms up or loses its calibration."""
LOAD_PARAMETERS, LOAD_UNITS = 4, ("kg", "kg m", "kg m", "kg m")
"""Number and units of a load's parameters: mass, and mass times position (3) in the frame of the last joint."""
LOAD_PRIOR = NormalPrior(
    np.array([1.0, 0.2, 0.2, 0.2]), np.zeros(LOAD_PARAMETERS), np.full(LOAD_PARAMETERS, -np.inf),
    np.full(LOAD_PARAMETERS, np.inf),
)  # fmt: skip
"""Prior of a load's mass, kg, and mass times position, kg m: 1 kg at 0.2 m; it only matters where the motion does not
identify the load."""
APART = "more_"
"""Before the name of an effect that is added to a model, which may have the effect already."""


@dataclass(frozen=True, eq=False)
class SharedChange:
    """A change that several channels show: of the load at the tool, or of the offsets of a sensor.

    Attributes:
        name: name of its effect.
        columns: indices of its k parameters among the unknowns.
        prior: of the parameters.
        units: (k,) units.
        channels: (k,) index of the channel to which each parameter belongs, which an event names.
    """

    name: str
    columns: np.ndarray
    prior: NormalPrior
    units: tuple[str, ...]
    channels: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class WatchedChanges:
    """What can change in an arm, and its columns: S parameters of shared changes, and C changes of each joint.

    Attributes:
        channels: the nc channels that show it.
        shared: the changes that several channels show; the first one is that of the load.
        names: (C,) name of each change of a joint: that of its effect, with the quantity where it has several.
        units: (nj) times (C,) units.
        steady: index of the change that is a constant torque.
        function: ``(q, v, a, bandwidth) -> (columns, way)``: (nc, S + C) derivatives of the readings with respect to
            the shared parameters, of which the first ones are an added load's mass, kg, and mass times position, kg m,
            and to each change of the joint; (nj,) expected signs of the velocities. A sensor's axis has an offset and a
            gain of its own as a joint's torque has, which describe its errors and are never told.
    """

    channels: WatchedChannels
    shared: tuple[SharedChange, ...]
    names: tuple[str, ...]
    units: tuple[tuple[str, ...], ...]
    steady: int
    function: PreallocatedFunction

    @classmethod
    def of(
        cls, model: ArmModel, further: Sequence[Effect] = (), channels: WatchedChannels | None = None
    ) -> "WatchedChanges":
        """The changes of an arm that are watched: `USUAL_CHANGES`, and those of further effects.

        Without `channels`, all channels of the arm show them.

        Raises:
            InputError: an effect of the model, or a further one, cannot be watched.
        """
        model, joints = without_past_dependent_effects(model), model.arm.joints
        channels = WatchedChannels.of(model) if channels is None else channels
        q, v, a = (ca.SX.sym(name, len(joints)) for name in "qva")
        K, more = ca.SX.sym("bandwidth"), ca.SX.sym("more", LOAD_PARAMETERS)
        links = [ca.SX(link) for link in model.link_parameters().values()]
        load = rigid_torques(model.arm.model, links, ca.SX(model.gravity()), q, v, a)
        last = joints.index(model.joints[-1])
        links[last] = ca.vertcat(links[last][:4] + more, links[last][4:])
        heavier = rigid_torques(model.arm.model, links, ca.SX(model.gravity()), q, v, a)
        expected, _, _, way = predicted_reading(model, channels, q, v, a, K)
        _, gain, _ = torques_added_by_effects(
            model, (q, v, a), way, load, ca.SX.ones(len(joints)), ca.SX(model.theta())
        )
        shared = [
            SharedChange("payload", np.arange(LOAD_PARAMETERS), LOAD_PRIOR, LOAD_UNITS, (last,) * LOAD_PARAMETERS)
        ]
        columns = [ca.diag(gain) @ ca.substitute(ca.jacobian(heavier, more), more, ca.SX.zeros(LOAD_PARAMETERS))]
        columns = [_with_sensed_loads(model, channels, columns[0], (q, v, a), more)]
        for sensor in channels.sensors:
            change, column = _offset_of(model, channels, sensor, (q, v, a), columns)
            shared.append(change)
            columns.append(column)
        names, units = list[str](), list[list[str]]()
        usual = {effect.name for effect in USUAL_CHANGES}
        for effect in (*USUAL_CHANGES, *dict.fromkeys(effect for effect in further if effect.name not in usual)):
            found = _columns(model, effect, (q, v, a), way, load)
            names += [effect.name if len(found) == 1 else f"{effect.name}.{short}" for short in found]
            for column, own in found.values():
                columns.append(ca.vertcat(column, _error_of_sensors(effect, expected[len(joints) :, 0])))
                units.append(own)
        outputs = [ca.densify(ca.horzcat(*columns)), way]
        function = ca.Function("columns", [q, v, a, K], outputs, ["q", "v", "a", "bandwidth"], ["columns", "way"])
        built = compile_functions(f"watch_columns_{len(joints)}", {"columns": function})["columns"]
        steady = names.index(simplest_effect(OFFSET).name)
        own_units = tuple(zip(*units, strict=True))
        return cls(channels, tuple(shared), tuple(names), own_units, steady, PreallocatedFunction(built))

    @property
    def shared_parameters(self) -> int:
        """S: number of parameters of the changes that act on several joints at once, such as a load."""
        return sum(len(change.columns) for change in self.shared)

    @property
    def own(self) -> np.ndarray:
        """(C,) indices of the joints' changes among the columns."""
        return self.shared_parameters + np.arange(len(self.names))


def _with_sensed_loads(
    model: ArmModel, channels: WatchedChannels, torques: ca.SX, motion: tuple[ca.SX, ca.SX, ca.SX], more: ca.SX
) -> ca.SX:
    """(nc, 4) columns of the load, of which those of the joints' torques are known."""
    sensed = [
        ca.substitute(ca.jacobian(sensor_reading(model, name, motion, more), more), more, ca.SX.zeros(LOAD_PARAMETERS))
        for name in channels.sensors
    ]
    return ca.vertcat(torques, *sensed)


def _offset_of(
    model: ArmModel,
    channels: WatchedChannels,
    sensor: str,
    motion: tuple[ca.SX, ca.SX, ca.SX],
    before: Sequence[ca.SX],
) -> tuple[SharedChange, ca.SX]:
    """The change of the offsets of a sensor, and its (nc, 6) columns, after the columns `before`."""
    at, quantities = channels.of_sensor(sensor), wrench_offset.quantities.values()
    theta, added = ca.SX.sym("offset", len(quantities)), replace(wrench_offset, name=APART + wrench_offset.name)
    column = ca.SX.zeros(len(channels.names), len(quantities))
    column[at, :] = ca.jacobian(sensor_reading(model, sensor, motion, beside=(added, theta)), theta)
    widths, none, infinite = np.array([q.typical for q in quantities]), np.zeros(len(quantities)), np.inf
    prior = NormalPrior(widths, none, none - infinite, none + infinite)
    columns = sum(one.numel() // len(channels.names) for one in before) + np.arange(len(quantities))
    units = tuple(q.unit for q in quantities)
    return SharedChange(wrench_offset.name, columns, prior, units, tuple(range(at.start, at.stop))), column


def _error_of_sensors(effect: Effect, expected: ca.SX) -> ca.SX:
    """(6 s,) column of an effect of joints that describes the error of sensors too, which read what is expected."""
    slots = slots_of(effect).names
    return expected if slots == {GAIN} else ca.SX.ones(expected.numel()) if slots == {OFFSET} else 0 * expected


def _columns(
    model: ArmModel, effect: Effect, motion: tuple[ca.SX, ca.SX, ca.SX], way: ca.SX, load: ca.SX
) -> dict[str, tuple[ca.SX, list[str]]]:
    """Column (nj,) and unit in each joint of every quantity of an effect that has a column."""
    n = len(model.arm.joints)
    if effect.acts_on not in model.stages or not effect.in_joint:
        raise InputError(f"a change of '{effect.name}' is none of a joint: name an effect on joints, --changes")
    added = replace(effect, name=APART + effect.name)
    whole = model.with_effect(added)
    own = [name for name in whole.names if name.startswith(added.name)]
    theta, values = ca.SX.sym("theta", len(own)), ca.SX(whole.theta())
    for k, name in enumerate(own):
        values[whole.names.index(name)] = theta[k]
    torque, gain, offset = torques_added_by_effects(whole, motion, way, load, ca.SX.ones(n), values)
    reading, found = gain * (load + torque) + offset, dict[str, tuple[ca.SX, list[str]]]()
    for short in effect.quantities:
        column, units = ca.SX.zeros(n), [""] * n
        for i, joint in enumerate(model.arm.joints):
            name = f"{added.name}.{short}[{joint}]"
            if name in own:
                everywhere = ca.jacobian(reading, theta[own.index(name)])
                column[i], units[i] = everywhere[i], whole.parameters[name].unit
                if ca.depends_on(everywhere, theta) or any(everywhere[k].nnz() for k in range(n) if k != i):
                    raise InputError(
                        f"a change of '{effect.name}' cannot be watched: no torque of its joint alone is linear in "
                        f"'{short}'; leave it out of --changes"
                    )
        if column.nnz() and not ca.simplify(column).is_zero():
            found[short] = column, units
    if not found:
        raise InputError(
            f"'{effect.name}' changes no torque at a single instant, so no watch sees it change: leave it out "
            "of --changes"
        )
    return found
