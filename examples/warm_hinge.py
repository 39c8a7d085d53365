"""Makes two recordings of a pendulum whose hinge is the smoother the warmer it is: warm_1.csv and warm_2.csv.

An angle sensor reads 100 times a second and a thermometer in the oil ten times; the oil warms and cools. Then:
`armdyn discover model.toml warm_1.csv --held-out warm_2.csv --output law.py`, see docs/discover.md.
"""

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

LENGTH, MASS, GRAVITY = 0.368, 0.08, 9.81
FRICTION, COLDER = 1.2e-3, 6.0
"""N m s/rad at 22 degC, and the K over which it grows e-fold."""


def write(path: Path, start: float, mean: float, seed: int) -> None:
    """Write a recording of a swing from an angle, rad, with oil of a mean temperature, degC."""
    rng = np.random.default_rng(seed)

    def temperature(t):
        return mean + 6.0 * np.sin(2 * np.pi * t / 17.0 + seed) + 3.0 * np.sin(2 * np.pi * t / 7.3)

    def rate(t, y):
        friction = 3e-4 + FRICTION * np.exp((22.0 - temperature(t)) / COLDER)
        return [y[1], -GRAVITY / LENGTH * np.sin(y[0]) - friction * y[1] / (MASS * LENGTH**2)]

    time = np.arange(0.0, 20.0, 0.01)
    angle = solve_ivp(rate, (0.0, 20.0), [start, 0.0], t_eval=time, rtol=1e-8, atol=1e-10).y[0]
    angle += 1e-3 * rng.standard_normal(len(time))
    read = temperature(time) + 0.02 * rng.standard_normal(len(time))
    rows = ["time [s],swing_angle [rad],extra.temperature [degC]"]
    for i, (t, a, c) in enumerate(zip(time, angle, read, strict=True)):
        rows.append(f"{t:.2f},{a:.5f}," + (f"{c:.2f}" if i % 10 == 0 else ""))
    path.write_text("\n".join(rows) + "\n")


def main(folder: Path = Path()) -> None:
    """Write both."""
    write(folder / "warm_1.csv", 0.6, 22.0, 1)
    write(folder / "warm_2.csv", -0.45, 26.0, 2)


if __name__ == "__main__":
    main()
