"""A double pendulum and a crane in MuJoCo, with friction and drag that the models do not know."""

import mujoco
import numpy as np

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
CRANE = """
<mujoco>
  <option timestep="{step}" gravity="0 0 -9.81"/>
  <worldbody>
    <body>
      <joint axis="1 0 0" type="slide"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <body>
        <joint axis="0 1 0"/>
        <inertial pos="0 0 0" mass="1e-9" diaginertia="1e-9 1e-9 1e-9"/>
        <body name="payload">
          <joint axis="0 0 -1" type="slide"/>
          <inertial pos="0 0 0" mass="12" diaginertia="1e-9 1e-9 1e-9"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def double_pendulum(start, damping=(0.0, 0.0), dry=(0.0, 0.0), seconds=8.0):
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
    """Columns time, trolley, rope, sway, load cell.

    Trolley and rope move as `motion(t)` tells: (2, 3) both with rate and acceleration. MuJoCo's mass matrix and bias
    forces give the sway and the rope's pull.
    """
    model = mujoco.MjModel.from_xml_string(CRANE.format(step=STEP))
    data, payload = mujoco.MjData(model), 3
    matrix, phi, rate, rows = np.zeros((3, 3)), sway, 0.0, []
    for k in range(round(seconds / STEP) + 1):
        told = motion(k * STEP)
        data.qpos[:], data.qvel[:] = (told[0, 0], phi, told[1, 0]), (told[0, 1], rate, told[1, 1])
        data.xfrc_applied[:] = 0.0
        mujoco.mj_forward(model, data)
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, payload, velocity, 0)
        outer = np.zeros(3)
        force = -drag * np.linalg.norm(velocity[3:]) * velocity[3:]
        mujoco.mj_applyFT(model, data, force, np.zeros(3), data.xpos[payload], payload, outer)
        mujoco.mj_fullM(model, data, matrix)
        needed = data.qfrc_bias - outer
        acceleration = -(needed[1] + matrix[1, 0] * told[0, 2] + matrix[1, 2] * told[1, 2]) / matrix[1, 1]
        pull = -(needed[2] + matrix[2] @ [told[0, 2], acceleration, told[1, 2]])
        if k % EVERY == 0:
            rows.append([k * STEP, told[0, 0], told[1, 0], phi, pull * (1 - sheave * np.tanh(told[1, 1] / 1e-3))])
        rate += STEP * acceleration
        phi += STEP * rate
    return np.array(rows)


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
