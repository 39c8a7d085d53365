"""A double pendulum in MuJoCo and a crane, with friction and drag that the models do not know."""

import mujoco
import numpy as np
from scipy.integrate import solve_ivp

STEP = 5e-4
EVERY = 20  # steps between samples: 100 Hz
DOUBLE = """
<mujoco>
  <option timestep="{step}" gravity="0 0 -9.81" integrator="RK4"/>
  <default><geom type="capsule" size="0.005" contype="0" conaffinity="0" mass="0"/></default>
  <worldbody>
    <body>
      <joint name="upper" axis="0 1 0" damping="{damping[0]}" frictionloss="{dry[0]}" solreffriction="0.002 1"/>
      <inertial pos="0 0 -0.16" mass="0.5" diaginertia="{i1} {i1} 1e-9"/>
      <body pos="0 0 -0.32">
        <joint name="lower" axis="0 1 0" damping="{damping[1]}" frictionloss="{dry[1]}" solreffriction="0.002 1"/>
        <inertial pos="0 0 -0.125" mass="0.3" diaginertia="{i2} {i2} 1e-9"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def double_pendulum(start, damping=(0.0, 0.0), dry=(0.0, 0.0), seconds=5.0):
    """Columns time, angle of the upper hinge, angle of the lower one, from rest at `start`, (2,) rad."""
    inertias = {"i1": 0.5 * 0.32**2 / 12, "i2": 0.3 * 0.25**2 / 12}
    model = mujoco.MjModel.from_xml_string(DOUBLE.format(step=STEP, damping=damping, dry=dry, **inertias))
    data = mujoco.MjData(model)
    data.qpos[:] = start
    rows = []
    for k in range(round(seconds / STEP) + 1):
        if k % EVERY == 0:
            rows.append([k * STEP, *data.qpos])
        mujoco.mj_step(model, data)
    return np.array(rows)


def crane(motion, drag=0.0, sheave=0.0, sway=0.05, seconds=12.0):
    """Columns time, trolley, rope, sway, load cell, of 12 kg on a rope, by the moments about the trolley.

    Trolley and rope move as `motion(t)` tells: (2, 3) both with rate and acceleration.
    """

    def acceleration(t, phi, rate):
        """Of the sway, rad/s^2, and the rope's pull, N."""
        (_, v, a), (rope, reeled, faster) = motion(t)
        s, c = np.sin(phi), np.cos(phi)
        velocity = np.array([v - reeled * s - rope * rate * c, rope * rate * s - reeled * c])
        force = -drag * np.hypot(*velocity) * velocity
        across, along = force @ [-c, s], force @ [-s, -c]
        turned = (a * c - 9.81 * s - 2 * reeled * rate + across / 12.0) / rope
        return turned, 12.0 * (9.81 * c + a * s + rope * rate**2 - faster) + along

    time = STEP * EVERY * np.arange(round(seconds / STEP / EVERY) + 1)
    phi, rate = solve_ivp(
        lambda t, y: [y[1], acceleration(t, *y)[0]], (0.0, time[-1]), (sway, 0.0), t_eval=time, rtol=1e-9, atol=1e-11
    ).y
    told = np.array([motion(t) for t in time])
    pull = np.array([acceleration(*row)[1] for row in zip(time, phi, rate, strict=True)])
    cell = pull * (1 - sheave * np.tanh(told[:, 1, 1] / 1e-3))
    return np.column_stack([time, told[:, :, 0], phi, cell])


def carried(seed):
    """A trolley and a rope that move smoothly to and fro, each run in its own way."""
    rng = np.random.default_rng(seed)
    sizes, paces, phases = rng.uniform(0.2, 0.4, (2, 2)), rng.uniform(0.4, 1.6, (2, 2)), rng.uniform(0, 6, (2, 2))
    mean = np.array([0.0, 3.0])

    def motion(t):
        angle = paces * t + phases
        value, slope, curve = (sizes * np.sin(angle), sizes * paces * np.cos(angle), -sizes * paces**2 * np.sin(angle))
        return np.column_stack([mean + value.sum(1), slope.sum(1), curve.sum(1)])

    return motion


def write(path, head, rows, noise, seed):
    """A recording with noise on all columns but the time."""
    noisy = rows.copy()
    noisy[:, 1:] += np.random.default_rng(seed).normal(size=noisy[:, 1:].shape) * noise
    np.savetxt(path, noisy, "%.9g", ",", header=head, comments="")
    return str(path)
