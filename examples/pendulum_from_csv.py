"""A pendulum from two CSV files: fit it, ask what its model lacks, repair it.

The recordings hold the gripper's position in mm and the string's tension in mN, as a lab would write them:
units are read from the header.
"""

from pathlib import Path

import armdyn

HERE = Path(__file__).parent


def main() -> armdyn.Repair:
    """Repair the model of a load on a string; in a notebook the result shows itself."""
    runs = [armdyn.read_run(HERE / f"pendulum/swing_{number}.csv") for number in (1, 2)]

    # What was measured by hand is a prior, not a truth.
    model = armdyn.pendulum.pendulum_model(length=0.36, mass=0.08).with_prior("mass", 0.08, 0.0004)

    # One recording is fitted, the other one judges: it takes no part in any fit.
    training, held_out = runs[:1], runs[1:]
    print(armdyn.compare(model, training, held_out).sentence)

    found = armdyn.repair(model, training, held_out)
    print(found.sentence)
    for name, parameter in found.model.parameters.items():
        if parameter.std is not None:
            print(f"{name}: {parameter.value:.4g} ± {parameter.std:.2g} {parameter.unit}")

    # found.plot().show() draws measured, before and after; found.to_dataframe() is a table for pandas.
    return found


if __name__ == "__main__":
    main()
