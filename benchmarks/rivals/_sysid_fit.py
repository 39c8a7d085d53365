"""MuJoCo's own system identification of a servo arm, told which parameters are unknown.

Of each joint the servo's gain, viscous friction, dry friction and armature; the delay of all joints, as that of their
sensors, which is how the toolbox has it; and the play of the joint that has some. On request it is also told that all
servos are of one kind, and have one gain. It has the arm's bodies from the file that armdyn exports of the description,
the commands at every time step as they hold, and the start of each recording.
"""

import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from time import process_time
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))
import mujoco
import numpy as np
from _servo_cases import GAIN_NAME, JOINTS, PLAY_NAME, ServoCase, add_play

from armdyn.arm.closed_loop.rollout import simulation_windows
from armdyn.arm.model import arm_model
from armdyn.run import Run
from pipeline.exports.mujoco_file import mujoco_text

TIME_STEP = 2e-3
"""MuJoCo's default [s]."""
GIVEN_GAIN, LIMIT = 8.9, 3.35
"""Of the servo's data sheet, N m/rad and N m, which armdyn has as well."""
UNKNOWN = {  # start, least and largest value
    GAIN_NAME: (GIVEN_GAIN, 1.0, 50.0),
    "joint_viscous_friction.coefficient": (0.3, 0.0, 5.0),
    "joint_coulomb_friction.torque": (0.05, 0.0, 2.0),
    "rotor_inertia.inertia": (0.01, 1e-5, 0.2),
}
DELAY, PLAY = (0.01, 0.0, 0.1), (0.005, 1e-4, 0.05)
"""The same, of the delay [s] and the play [rad]."""


class MissingSysidError(Exception):
    """The toolbox is not installed; the message gives the command that installs it."""


@dataclass(frozen=True)
class SysidFit:
    """What the toolbox found.

    Attributes:
        values: by parameter of armdyn's model; the gain by joint, ``gain[<joint>]``, and ``delay``.
        held_out: rms error of the positions in the held-out recordings [rad].
        training: the same in those that were fitted.
        seconds: processor time [s].
        told: number of the parameters that it was told to fit.
    """

    values: dict[str, float]
    held_out: float
    training: float
    seconds: float
    told: int


def toolbox() -> Any:
    """The module `mujoco.sysid`.

    Raises:
        MissingSysidError: it or what it needs is not installed.
    """
    from mujoco import sysid

    if not hasattr(sysid, "optimize"):  # it imports without what it needs
        raise MissingSysidError("mujoco.sysid lacks what it needs: pip install 'mujoco[sysid]'")
    return sysid


def fit(case: ServoCase, steps: int, *, one_gain: bool) -> SysidFit:
    """Identify the arm of a case in at most `steps` steps of the toolbox's own optimiser, on one thread.

    Args:
        case: the recordings.
        steps: largest number of steps.
        one_gain: whether all servos have one gain.

    Raises:
        MissingSysidError: the toolbox is not installed.
    """
    sysid = toolbox()
    begun = process_time()
    spec = _spec(case)
    parameters, transform = _parameters(sysid, case, one_gain), sysid.SignalTransform(normalize=False)
    transform.delay("*", parameters["delay"])

    def residuals(runs: Sequence[Run]) -> Callable[..., Any]:
        sequences = [_sequences(sysid, spec, run) for run in runs]
        return sysid.build_residual_fn(  # type: ignore[no-any-return]
            models_sequences=sequences, modify_residual=transform.apply, n_threads=1
        )

    training = residuals(case.training)
    with redirect_stdout(StringIO()):  # the optimiser reports each step
        found, _ = sysid.optimize(parameters, training, optimizer="mujoco", verbose=False, max_iters=steps)
    seconds = process_time() - begun
    errors = [_rms(of(found.as_vector(), found)[0]) for of in (residuals(case.held_out), training)]
    values = {name: float(p.value[0]) for name, p in found.items()}
    fitted = len(values)
    values |= {f"{GAIN_NAME}[{joint}]": values[GAIN_NAME] for joint in JOINTS if one_gain}
    return SysidFit(values, *errors, seconds, fitted)


def _rms(residuals: Sequence[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate([np.ravel(one) for one in residuals]) ** 2)))


def _spec(case: ServoCase) -> mujoco.MjSpec:
    """The described arm with position servos, and a sensor of each link's position."""
    spec = mujoco.MjSpec.from_string(mujoco_text(arm_model(case.urdf))[0])
    spec.option.timestep, spec.option.integrator = TIME_STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for name in JOINTS:
        spec.joint(name).limited = mujoco.mjtLimited.mjLIMITED_FALSE
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        servo.forcelimited, servo.forcerange = True, [-LIMIT, LIMIT]
    if case.playing is not None:
        add_play(spec, case.playing, PLAY[0])
        link = spec.add_tendon(name="link")
        for name in (case.playing, f"{case.playing}_play"):
            link.wrap_joint(name, 1.0)
    for name in JOINTS:
        plays = name == case.playing
        kind, seen = (mujoco.mjtSensor.mjSENS_TENDONPOS, mujoco.mjtObj.mjOBJ_TENDON) if plays else (
            mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtObj.mjOBJ_JOINT)  # fmt: skip
        spec.add_sensor(name=f"{name}_pos", type=kind, objtype=seen, objname="link" if plays else name)
    return spec


def _parameters(sysid: Any, case: ServoCase, one_gain: bool) -> Any:
    """The unknown parameters, each with what it changes."""
    found = sysid.ParameterDict()

    def write_gain(joints: Sequence[str]) -> Callable[[Any, Any], None]:
        def write(spec: Any, parameter: Any) -> None:
            for servo in map(spec.actuator, joints):
                servo.gainprm[0], servo.biasprm[1] = parameter.value[0], -parameter.value[0]

        return write

    def write_joint(joint: str, attribute: str) -> Callable[[Any, Any], None]:
        def write(spec: Any, parameter: Any) -> None:
            value = float(parameter.value[0])
            values = {"damping": np.array([value, 0.0, 0.0]), "range": [-value, value]}
            setattr(spec.joint(joint), attribute, values.get(attribute, value))

        return write

    for joint in JOINTS:
        writers = (write_gain([joint]), *(write_joint(joint, a) for a in ("damping", "frictionloss", "armature")))
        for (name, values), write in zip(UNKNOWN.items(), writers, strict=True):
            if name != GAIN_NAME or not one_gain:
                found.add(sysid.Parameter(f"{name}[{joint}]", *values, modifier=write))
    if one_gain:
        found.add(sysid.Parameter(GAIN_NAME, *UNKNOWN[GAIN_NAME], modifier=write_gain(JOINTS)))
    if case.playing is not None:
        found.add(sysid.Parameter(PLAY_NAME, *PLAY, modifier=write_joint(f"{case.playing}_play", "range")))
    found.add(sysid.Parameter("delay", *DELAY))
    return found


def _sequences(sysid: Any, spec: mujoco.MjSpec, run: Run) -> Any:
    """One recording, from its first state."""
    model = spec.compile()
    (window,) = simulation_windows(run, JOINTS, np.inf)
    time = np.arange(0.0, window.end - window.begin + TIME_STEP / 2, TIME_STEP)
    told = [run.channels[f"q_cmd.{j}"].zero_order_hold_values(window.begin + time + 1e-9) for j in JOINTS]
    series, q, v = sysid.TimeSeries, np.zeros(model.nq), np.zeros(model.nv)
    places = [int(model.joint(joint).qposadr[0]) for joint in JOINTS]  # each joint is one coordinate
    q[places], v[places] = window.start
    return sysid.ModelSequences(
        run.name, spec, run.name,
        sysid.create_initial_state(model, q, v),
        series(time, np.column_stack(told), series.compute_all_control_mapping(model)),
        series(window.time - window.begin, window.q, series.compute_all_sensor_mapping(model)),
    )  # fmt: skip
