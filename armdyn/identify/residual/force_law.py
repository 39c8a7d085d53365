"""Find the simple law that a missing force follows: a step where the motion reverses, a straight line, a parabola.

A law is a sum of at most two terms in one quantity, with or without a constant, fitted to the means of the bins by
weighted least squares. With k terms, n bins of standard errors s_i and the remaining chi2, its evidence is (Schwarz,
Ann. Stat. 6, 1978)

    ln L = -n/2 ln f^2 - chi2 / (2 f^2) - k/2 ln n,    f^2 = max(1, chi2/n):

where f is a factor, at least 1, on the standard errors: it is larger where no law fits all bins.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from armdyn.estimation.solve import least_squares
from armdyn.identify.residual.missing_force import ForceCurve, min_standard_error, pool_curves
from armdyn.identify.settings import DEFAULT_SETTINGS
from armdyn.recording.channels import FloatArray

QUANTITY_BY_UNIT = {"rad/s^2": "acceleration", "m/s^2": "acceleration", "N m": "torque", "N": "force"}
"""Name of the missing quantity by its unit."""
RATE_QUANTITY = "rate"
"""Name of the missing quantity with any other unit: the time derivative of a state."""


@dataclass(frozen=True)
class ForceShape:
    """A shape in which a force may depend on one quantity, such as a step or a straight line.

    Attributes:
        force: function from (b,) values of the quantity to (b,) forces, for a size of one.
        words: the dependence in words, with the placeholders ``{size}``, ``{sense}`` (grows or falls), ``{what}``
            (joint or swing) and ``{against}`` (the quantity).
        factor: ratio of the size that is printed to the fitted coefficient; 2 for a sign function, whose step is twice
            as high.
        power: power of the quantity in the unit of the size.
        cause: physical cause of such a force where it brakes a motion; empty where there is no single one.
        effects: parts of the names of effects that have this cause.
    """

    force: Callable[[FloatArray], FloatArray]
    words: str
    factor: float = 1.0
    power: int = 1
    cause: str = ""
    effects: tuple[str, ...] = ()


DRY_FRICTION_EFFECTS = ("coulomb", "asymmetric", "stribeck", "load_friction")
STEP_SHAPE = ForceShape(
    np.sign, "steps by {size} where the {what} reverses", 2.0, 0, "dry friction of half that size", DRY_FRICTION_EFFECTS
)
VISCOUS_SHAPE = ForceShape(
    np.positive, "{sense} in proportion to the speed, by {size}",
    cause="viscous friction", effects=("viscous", "linear_drag"),
)  # fmt: skip
SQUARE_SHAPE = ForceShape(
    lambda x: x * np.abs(x), "{sense} with the square of the speed, by {size}",
    power=2, cause="air drag", effects=("quadratic_drag",),
)  # fmt: skip
LINE_SHAPE = ForceShape(np.positive, "{sense} with the {against}, by about {size}")
DRIFT_SHAPE = ForceShape(np.positive, "{sense} with time, by about {size}")
CONSTANT_SHAPE = ForceShape(np.ones_like, "is {size} at every speed and position", power=0)
SHAPES_BY_QUANTITY = {"speed": (STEP_SHAPE, VISCOUS_SHAPE, SQUARE_SHAPE), "time": (DRIFT_SHAPE,)}
"""Shapes that are tried for each quantity; for every other quantity a straight line."""


@dataclass(frozen=True)
class ForceTerm:
    """One term of the law of a missing force: a shape with its fitted size.

    Attributes:
        shape: how the force depends on the quantity.
        against: name of the quantity on which it depends; empty for a constant.
        size: height of a step, or force per unit (or squared unit) of the quantity, with sign.
        unit: unit of the size.
    """

    shape: ForceShape
    against: str
    size: float
    unit: str


@dataclass(frozen=True)
class ForceLaw:
    """The law that a missing force follows.

    Attributes:
        joint: name of the joint; None for a model without joints.
        quantity: ``"torque"``, ``"force"``, ``"acceleration"`` or ``"rate"``.
        terms: the terms for which the evidence is very strong.
        similar_joints: names of other joints whose missing force has the same terms, with other sizes.
    """

    joint: str | None
    quantity: str
    terms: tuple[ForceTerm, ...]
    similar_joints: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """The law in words: ``"the missing torque of elbow steps by 1.2 N m where the joint reverses"``, no stop."""
        whose = f" of {self.joint}" if self.joint else ""
        driven = self.quantity in ("torque", "force")
        what = "joint" if driven else "motion" if self.joint else "swing"
        # A drive has to supply what friction takes; a swing is slowed by friction.
        friction = [t for t in self.terms if t.shape.cause]
        loss = 1.0 if driven else -1.0
        drives = bool(friction) and all(loss * t.size < 0.0 for t in friction)
        along = -loss if drives else loss
        said = " and ".join(_said(t, what, t.size * (along if t.shape.cause else 1.0) > 0.0) for t in self.terms)
        text = f"the missing {self.quantity}{whose} {said}"
        text += f" (likewise {_listed(self.similar_joints)})" if self.similar_joints else ""
        if drives:
            return f"{text}, which drives the motion and is not friction"
        # The medium around a joint may be oil as well.
        causes = [
            "drag" if self.joint and t.shape is SQUARE_SHAPE else t.shape.cause for t in friction if loss * t.size > 0
        ]
        return f"{text}: {' and '.join(causes)}" if causes else text


def find_force_law(curves: Iterable[ForceCurve]) -> ForceLaw | None:
    """Find the law of the missing force, for the joint with the largest one among joints with a clear law.

    Args:
        curves: curves of the missing force, the joint with the largest one first.

    Returns:
        The law, or None where no joint has a clear one.
    """
    by_joint: dict[str | None, list[ForceCurve]] = {}
    for curve in pool_curves(curves):
        by_joint.setdefault(curve.joint, []).append(curve)
    found = [one for one in map(_law, by_joint.values()) if one is not None]
    if not found:
        return None
    first = found[0]
    alike = (one.joint for one in found[1:] if one.joint and _kinds(one) == _kinds(first))
    return ForceLaw(first.joint, first.quantity, first.terms, tuple(alike))


def _kinds(one: ForceLaw) -> list[tuple[ForceShape, str, bool]]:
    """The terms of a law without their sizes, to compare two laws."""
    return [(term.shape, term.against, term.size > 0.0) for term in one.terms]


def force_law_sentence(curves: Iterable[ForceCurve], named: Collection[str] = ()) -> str:
    """Sentence, with a space after it, on the law that a missing force follows; empty where no law is clear.

    Args:
        curves: curves of the missing force.
        named: names of the effects that were found. Where none of them brakes the motion as the law does, the sentence
            is empty, because two effects together may look like a third one.
    """
    found = find_force_law(curves)
    parts = [part for term in found.terms for part in term.shape.effects] if found is not None else []
    if named and parts and not any(part in name for part in parts for name in named):
        return ""
    return f"{found.sentence[:1].upper()}{found.sentence[1:]}. " if found is not None else ""


def _law(curves: Sequence[ForceCurve]) -> ForceLaw | None:
    """The law of one joint: the terms that every plausible law has."""
    tried = [fitted for curve in curves for fitted in _fitted(curve)]
    gain, best = max(tried, key=lambda one: one[0])
    least = gain - DEFAULT_SETTINGS.search.acceptance_nats
    plausible = [{(t.shape, t.against) for t in terms} for evidence, terms in tried if evidence >= least]
    told = tuple(t for t in best if all((t.shape, t.against) in other for other in plausible))
    # Beside a term that varies, a constant is only the part of the force that no shape describes.
    told = told if len(best) == 1 else tuple(t for t in told if t.shape is not CONSTANT_SHAPE)
    return ForceLaw(curves[0].joint, QUANTITY_BY_UNIT.get(curves[0].unit, RATE_QUANTITY), told) if told else None


def _fitted(curve: ForceCurve) -> list[tuple[float, tuple[ForceTerm, ...]]]:
    """Evidence of every law in one quantity, relative to no force at all, with its terms."""
    shapes = SHAPES_BY_QUANTITY.get(curve.against, (LINE_SHAPE,))
    sets = [chosen for size in range(3) for chosen in combinations(shapes, size)]
    scale = max(float(np.max(np.abs(curve.x))), np.finfo(float).tiny)
    std = np.maximum(curve.std, min_standard_error(curve.std))
    y, found = curve.as_given / std, []
    for chosen in (*sets, *((*one, CONSTANT_SHAPE) for one in sets)):
        columns = np.array([shape.force(curve.x / scale) / std for shape in chosen]).reshape(len(chosen), len(y)).T
        values = least_squares(columns, y)
        evidence = _evidence(y - columns @ values, len(chosen)) - _evidence(y, 0)
        found.append((evidence, tuple(_term(s, v, scale, curve) for s, v in zip(chosen, values, strict=True))))
    return found


def _evidence(residual: FloatArray, terms: int) -> float:
    n, chi2 = len(residual), float(residual @ residual)
    spread = max(1.0, chi2 / n)
    return -n / 2 * float(np.log(spread)) - chi2 / (2 * spread) - terms / 2 * float(np.log(n))


def _term(shape: ForceShape, value: float, scale: float, curve: ForceCurve) -> ForceTerm:
    per = {0: "", 1: f" per {curve.x_unit}", 2: f" per ({curve.x_unit})^2"}[shape.power]
    against = "" if shape is CONSTANT_SHAPE else curve.against
    return ForceTerm(shape, against, shape.factor * float(value) / scale**shape.power, f"{curve.unit}{per}")


def _said(term: ForceTerm, what: str, grows: bool) -> str:
    size = term.size if term.shape is CONSTANT_SHAPE else abs(term.size)
    number = f"{float(f'{size:.2g}'):g} {term.unit}"
    against = "predicted load" if term.against == "load" else term.against.replace("_", " ")
    return term.shape.words.format(size=number, sense="grows" if grows else "falls", what=what, against=against)


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{len(names)} other joints"
