"""An effect of one's own: a magnet below the line, which no catalogue has. One function, then fit, diagnose, repair.

A function with `@armdyn.effect` is the whole effect: prediction, exact derivatives and control follow from it.
"""

from pathlib import Path

import casadi as ca

import armdyn

HERE = Path(__file__).parent
PLACE, WIDTH = 0.02, 0.03
"""m; where the magnet lies and how far it reaches, by ruler."""


@armdyn.effect(
    "magnet",
    acts_on="load",
    summary="A magnet below the line pulls the load towards it.",
    source="measured with a ruler and a spring scale",
)
def magnet(load, strength=armdyn.quantity("N", typical=0.02, lower=0.0, summary="scale of the pull")):
    """The load comes with its position (3,) m, velocity, mass; forces are added in N."""
    distance = (load.position[0] - PLACE) / WIDTH
    return load.with_force(ca.vertcat(-strength * distance / (1 + distance**2) ** 2, 0, 0))


def main() -> armdyn.Repair:
    """Repair with and without the effect in the catalogue."""
    runs = [HERE / f"pendulum/magnet_{number}.csv" for number in (1, 2)]
    model = armdyn.pendulum.pendulum_model(length=0.36, mass=0.08)

    print("the catalogue alone:", armdyn.compare(model, runs).sentence)
    found = armdyn.repair(model, runs, effects=[*armdyn.CATALOGUE.values(), magnet])
    print("with the magnet:", found.sentence)
    return found


if __name__ == "__main__":
    main()
