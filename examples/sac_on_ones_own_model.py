"""Sequential Action Control on one's own model: move the gripper so that the tension tells the string's length.

The model has air drag, as a repair may have found; SAC's gradient contains it without another line. Here the model
itself is moved: a robot would send the state that it measured.
"""

import numpy as np

import armdyn
from armdyn.control.sac import SacSettings, SacState, SequentialActionControl

SECONDS, NOISE = 4.0, 0.005
"""s; N, of one sample of the load cell."""
TINY = 1e-6
"""m; change of the length that gives derivatives."""


def main() -> dict[bool, float]:
    """Best possible standard deviation of the length [m] (Cramér and Rao), with SAC and after the first push alone."""
    model = armdyn.pendulum.pendulum_model(0.368, 0.08, [armdyn.CATALOGUE["quadratic_drag"]])
    model = model.with_values({"quadratic_drag.coefficient": 0.02})
    dynamics, theta, settings = model.dynamics(), model.physics_theta(), SacSettings()
    longer = theta + TINY * (np.arange(len(theta)) == model.physics_names.index("length"))
    control = SequentialActionControl(model, settings)

    def moved(load, parameters, gripper, dt):
        """The load's angle and momentum after a midpoint step."""
        rate = np.array(dynamics.derivative(load, gripper, parameters)).ravel()
        middle = gripper + 0.5 * dt * np.array([0, gripper[2], gripper[3], 0, 0, 0, 0])
        return load + dt * np.array(dynamics.derivative(load + 0.5 * dt * rate, middle, parameters)).ravel()

    std = {}
    for controlled in (False, True):
        x, v, information = 0.0, 0.1, 0.0  # a small push begins the motion
        load, load_if_longer = np.zeros(2), np.zeros(2)
        for step in range(round(SECONDS / settings.dt)):
            ahead = step % round(settings.sample_time / settings.dt)
            if ahead == 0:
                state = SacState(step * settings.dt, x, v, load, (load_if_longer - load) / TINY)
                schedule = control.act(state, model).schedule if controlled else np.zeros(settings.steps)
            u = schedule[ahead]
            gripper = np.array([0.0, x, v, u, 0, 0, 0])
            tension, other = dynamics.tension(load, gripper, theta), dynamics.tension(load_if_longer, gripper, longer)
            information += (float(other - tension) / TINY / NOISE) ** 2
            load, load_if_longer = (
                moved(load, theta, gripper, settings.dt),
                moved(load_if_longer, longer, gripper, settings.dt),
            )
            x, v = x + settings.dt * v + 0.5 * settings.dt**2 * u, v + settings.dt * u
        std[controlled] = information**-0.5
    print(f"standard deviation of the length after {SECONDS:g} s, at best:")
    print(f"  {1e3 * std[False]:.2f} mm after the push alone, {1e3 * std[True]:.2f} mm with SAC")
    return std


if __name__ == "__main__":
    main()
