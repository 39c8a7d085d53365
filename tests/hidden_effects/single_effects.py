"""How much of a torque error each single effect on a single joint explains, by plain least squares without noise.

It tells which cases have a clear answer: nothing of armdyn takes part.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from .dominant import Lump
from .imperfections import sliding
from .plant import World

THIN = 40
"""Samples of which one is used."""
ARM = 0.1
"""m from a link's frame to the point masses that span what its inertia may be."""
TINY = 1e-9
"""Of the largest singular value; smaller ones are those of numbers that cannot be seen."""
Atom = tuple[str, str]
"""Effect and joint."""


class SingleEffects:
    """Effects on joints, for the runs of one robot.

    Args:
        worlds: training runs, the held-out run and the exam.
    """

    def __init__(self, worlds: Sequence[World]) -> None:
        self._thinned = [slice(w.inner.start, w.inner.stop, THIN) for w in worlds]
        terms = [_terms(world, rows) for world, rows in zip(worlds, self._thinned, strict=True)]
        self._terms: dict[Atom, list[np.ndarray]] = {atom: [term[atom] for term in terms] for atom in terms[0]}

    def left(self, misfits: Sequence[np.ndarray]) -> Mapping[Atom, np.ndarray]:
        """By effect and joint: (r,) share of each run's squared error that is left when it is fitted to the training.

        Args:
            misfits: (k, nj) by run, see `World.misfit`; the first two are for training.
        """
        errors = [misfit[::THIN].ravel() for misfit in misfits]
        found = {}
        for atom, terms in self._terms.items():
            values = np.linalg.lstsq(np.vstack(terms[:2]), np.concatenate(errors[:2]), rcond=TINY)[0]
            found[atom] = np.array(
                [np.sum((e - term @ values) ** 2) / np.sum(e**2) for e, term in zip(errors, terms, strict=True)]
            )
        return found


def score(left: np.ndarray) -> float:
    """Logarithm of what is left in training and in the held-out run, weighed alike; lower is better."""
    return 0.5 * float(np.log(0.5 * (left[0] + left[1])) + np.log(left[2]))


def _terms(world: World, rows: slice) -> dict[Atom, np.ndarray]:
    """(k nj, p) torque per number of each effect on each joint."""
    plant = world.plant
    motion = world.motion.at(world.stamps[rows])
    q, v, a = motion
    load = plant.torques(motion, plant.described, {})
    one = np.ones_like(q)
    own: Mapping[str, Sequence[np.ndarray]] = {
        "gravity_spring": (np.sin(q), np.cos(q)),
        "joint_coulomb_friction": (sliding(v),),
        "joint_asymmetric_friction": (sliding(v), one),
        "joint_viscous_friction": (v,),
        "torque_offset": (one,),
        "rotor_inertia": (a,),
        "torque_gain": (load,),
    }
    found: dict[Atom, np.ndarray] = {}
    for j, joint in enumerate(plant.joints):
        for effect, columns in own.items():
            term = np.zeros((*q.shape, len(columns)))
            for k, column in enumerate(columns):
                term[:, j, k] = column[:, j]
            found[effect, joint] = term.reshape(q.size, -1)
        points = [plant.torques(motion, plant.described, {j: Lump(1.0, place)}) - load for place in _PLACES]
        found["link_inertia", joint] = np.stack(points, axis=-1).reshape(q.size, -1)
    here, *around = np.moveaxis(found["link_inertia", plant.joints[-1]], -1, 0)[:7]
    first = [around[2 * k] - around[2 * k + 1] for k in range(3)]  # what is quadratic in the place cancels
    found["payload", plant.joints[-1]] = np.stack([here, *first], axis=-1)
    return found


# Point masses at ten places span all that masses, centres and inertias can be.
_PLACES = tuple(
    (ARM * x, ARM * y, ARM * z)
    for x, y, z in (
        (0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (1, 1, 0), (0, 1, 1), (1, 0, 1),
    )
)  # fmt: skip
