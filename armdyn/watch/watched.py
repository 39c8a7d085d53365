"""Which changes of an arm a watch tells: of the load at its tool, and of effects in each of its joints.

Whether a watch can tell an effect is read from its equation: a joint's torque, or its reading, must depend on a
quantity linearly, by a factor that the motion alone gives. This factor is the quantity's column.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.arm.slots import DAMPING, FRICTION, GAIN, OFFSET, simplest_effect
from armdyn.arm.symbolic import rigid_torques, torques_added_by_effects
from armdyn.codegen import PreallocatedFunction, compile_functions
from armdyn.effects.effect import Effect
from armdyn.errors import InputError
from armdyn.watch.observer import predicted_reading, without_past_dependent_effects

USUAL_CHANGES = tuple(simplest_effect(slot) for slot in (FRICTION, DAMPING, OFFSET, GAIN))
"""Effects that are watched in every joint: what wears, warms up or loses its calibration."""
LOAD_PARAMETERS = 4
"""Number of a load's parameters: mass, kg, and mass times position (3), kg m, in the frame of the last joint."""
APART = "more_"
"""Before the name of an effect that is added to a model, which may have the effect already."""


@dataclass(frozen=True, eq=False)
class WatchedChanges:
    """The C changes that are told in each of nj joints, and their columns.

    Attributes:
        names: (C,) name of each change: that of its effect, with the quantity where the effect has several.
        units: (nj) times (C,) units.
        steady: index of the change that is a constant torque.
        function: ``(q, v, a, bandwidth) -> (columns, way)``: (nj, 4 + C) derivatives of the measured torques with
            respect to an added load's mass, kg, and mass times position, kg m, and to each change of the joint; (nj,)
            expected signs of the velocities.
    """

    names: tuple[str, ...]
    units: tuple[tuple[str, ...], ...]
    steady: int
    function: PreallocatedFunction

    @classmethod
    def of(cls, model: ArmModel, further: Sequence[Effect] = ()) -> "WatchedChanges":
        """The changes of an arm that are watched: `USUAL_CHANGES`, and those of further effects.

        Raises:
            InputError: an effect of the model, or a further one, cannot be watched.
        """
        model, joints = without_past_dependent_effects(model), model.arm.joints
        q, v, a = (ca.SX.sym(name, len(joints)) for name in "qva")
        K, more = ca.SX.sym("bandwidth"), ca.SX.sym("more", LOAD_PARAMETERS)
        links = [ca.SX(link) for link in model.link_parameters().values()]
        load = rigid_torques(model.arm.model, links, ca.SX(model.gravity()), q, v, a)
        last = joints.index(model.joints[-1])
        links[last] = ca.vertcat(links[last][:4] + more, links[last][4:])
        heavier = rigid_torques(model.arm.model, links, ca.SX(model.gravity()), q, v, a)
        way = predicted_reading(model, q, v, a, K)[3]
        _, gain, _ = torques_added_by_effects(
            model, (q, v, a), way, load, ca.SX.ones(len(joints)), ca.SX(model.theta())
        )
        columns = [ca.diag(gain) @ ca.substitute(ca.jacobian(heavier, more), more, ca.SX.zeros(LOAD_PARAMETERS))]
        names, units = list[str](), list[list[str]]()
        usual = {effect.name for effect in USUAL_CHANGES}
        for effect in (*USUAL_CHANGES, *dict.fromkeys(effect for effect in further if effect.name not in usual)):
            found = _columns(model, effect, (q, v, a), way, load)
            names += [effect.name if len(found) == 1 else f"{effect.name}.{short}" for short in found]
            for column, own in found.values():
                columns.append(column)
                units.append(own)
        outputs = [ca.densify(ca.horzcat(*columns)), way]
        function = ca.Function("columns", [q, v, a, K], outputs, ["q", "v", "a", "bandwidth"], ["columns", "way"])
        built = compile_functions(f"watch_columns_{len(joints)}", {"columns": function})["columns"]
        steady = names.index(simplest_effect(OFFSET).name)
        return cls(tuple(names), tuple(zip(*units, strict=True)), steady, PreallocatedFunction(built))

    @property
    def own(self) -> np.ndarray:
        """(C,) indices of the joints' changes among the columns."""
        return LOAD_PARAMETERS + np.arange(len(self.names))


def _columns(
    model: ArmModel, effect: Effect, motion: tuple[ca.SX, ca.SX, ca.SX], way: ca.SX, load: ca.SX
) -> dict[str, tuple[ca.SX, list[str]]]:
    """Column (nj,) and unit in each joint of every quantity of an effect that has a column."""
    n = len(model.arm.joints)
    if effect.acts_on not in model.stages or effect.reach == "base":
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
        raise InputError(f"a change of '{effect.name}' adds to no torque at an instant: leave it out of --changes")
    return found
