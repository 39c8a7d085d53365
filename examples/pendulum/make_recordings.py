"""Makes the recordings beside it: a simulated load on a string, with air drag, and with a magnet below the line."""

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
HIDDEN = {"swing": {"quadratic_drag": 0.04}, "magnet": {"magnet": 0.03}}


def main():
    """Write all four, by equations of their own, none of armdyn's."""
    sys.path.insert(0, str(HERE.parents[1] / "tests"))
    from worlds.pendulum import Setup, record

    for name, hidden in HIDDEN.items():
        for number in (1, 2):
            run = record(name, Setup(hidden=hidden, duration=8.0), np.random.default_rng([number, len(name)]))
            x, force = run.channels["gripper_x"], run.channels["load_force"]
            rows = [
                f"{t:.2f},{1e3 * p:.3f},{1e3 * f:.1f}" for t, p, f in zip(x.time, x.value, force.value, strict=True)
            ]
            text = "\n".join(["time [s],gripper_x [mm],load_force [mN]", *rows])
            (HERE / f"{name}_{number}.csv").write_text(text + "\n")
            (HERE / f"{name}_{number}.toml").write_text('description = "simulated"\n[noise]\nload_force = "3 mN"\n')


if __name__ == "__main__":
    main()
