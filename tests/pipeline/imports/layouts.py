"""Layouts of recordings as others write them: the headers of real logs, over numbers that are made up.

Each is modelled on a format that is in use, named beside it. A line ``many("actual_q_{0}", "q")`` is a column per joint
whose number counts from 0; ``{1}`` counts from 1. ``None`` marks what must not become a channel.
"""

# ruff: noqa: E501 - a layout is a line
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from pipeline.imports.joints import JointRange, RobotJoints

TIME = np.arange(160) * 0.02
UR = tuple(f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"))
ALPHABET = [2, 1, 0, 3, 4, 5]
"""Order of a UR's joints in its messages."""
SO101 = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
EFFORTS = (150.0, 150.0, 90.0, 28.0, 28.0, 28.0, 12.0)
PER = {"q": "", "v": "/s", "a": "/s^2"}


def robot(names, others=(), grippers=(), slides=False):
    ranges = {name: JointRange(slides, 0.5 if slides else 6.3, EFFORTS[min(i, 6)]) for i, name in enumerate(names)}
    return RobotJoints(tuple(names), tuple(others), tuple(grippers), ranges)


PANDA = robot([f"panda_joint{i}" for i in range(1, 8)], grippers=["panda_finger_joint1", "panda_finger_joint2"])
UR5 = robot(UR)
KUKA = robot([f"joint_a{i}" for i in range(1, 7)])
IIWA = robot([f"lbr_iiwa_joint_{i}" for i in range(1, 8)])
ABB = robot([f"joint_{i}" for i in range(1, 7)])
GEN3 = robot([f"joint_{i}" for i in range(1, 8)], grippers=["right_finger_bottom_joint", "left_finger_bottom_joint"])
JACO = robot([f"j2s6s200_joint_{i}" for i in range(1, 7)], grippers=[f"j2s6s200_joint_finger_{i}" for i in (1, 2, 3)])
XARM = robot([f"joint{i}" for i in range(1, 8)], grippers=["drive_joint"])
SO = robot(SO101, grippers=["gripper"])
BAXTER = robot(
    [f"right_{j}" for j in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")],
    others=["head_pan", *(f"left_{j}" for j in ("s0", "s1", "e0", "e1", "w0", "w1", "w2"))],
    grippers=["l_gripper_l_finger_joint"],
)
MOTOMAN = robot(["joint_1_s", "joint_2_l", "joint_3_u", "joint_4_r", "joint_5_b", "joint_6_t"])
ALOHA = robot(["waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate"], grippers=["gripper"])
DOUBLE = robot(["Joint1", "Joint2"])
SLIDE = robot(["slide"], slides=True)
NOBODY = RobotJoints()

_RNG = np.random.default_rng(0)
_PHASE, _SIZE, _PACE = _RNG.uniform(0, 6, 8), _RNG.uniform(0.6, 1.6, 8), _RNG.uniform(1.5, 3.5, 8)
_MEAN = _RNG.uniform(-1.2, 1.2, 8)


def signal(kind, joint):
    """What a joint does, in SI units: positions with their slopes, torques of a third of what the motors can."""
    phase = _PACE[joint] * TIME + _PHASE[joint]
    noise = 1e-4 * np.random.default_rng(joint).standard_normal(len(TIME))
    match kind:
        case "q":
            return _MEAN[joint] + _SIZE[joint] * np.sin(phase) + noise
        case "v":
            return _SIZE[joint] * _PACE[joint] * np.cos(phase) + 1e-2 * noise
        case "a":
            return -_SIZE[joint] * _PACE[joint] ** 2 * np.sin(phase)
        case "tau":
            return EFFORTS[min(joint, 6)] / 3 * np.cos(phase + 0.4)
        case _:
            return 0.4 * EFFORTS[min(joint, 6)] / 12 * np.cos(phase + 0.4)


FACTORS = {"rad": 1.0, "deg": 180 / np.pi, "m": 1.0, "mm": 1e3, "N m": 1.0, "mN m": 1e3, "N": 1.0, "A": 1.0, "mA": 1e3}


@dataclass(frozen=True)
class Made:
    """A column: header, values, and the channel and unit that it is; none for what is none."""

    header: str
    value: np.ndarray
    channel: str = ""
    unit: str = ""


@dataclass(frozen=True)
class Layout:
    """A format: name, robot, its columns for that robot, the time's header, factor and unit, the separator."""

    name: str
    joints: RobotJoints
    columns: Callable[[tuple[str, ...]], Iterable[Made]]
    time: str = "timestamp"
    unit: str = "s"
    start: float = 0.0
    separator: str = ","
    texts: dict[str, str] = field(default_factory=dict)

    def made(self):
        return list(self.columns(self.joints.arm))

    def text(self):
        """The file."""
        step, made = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[self.unit], self.made()
        rows = [[self.time, *self.texts, *(c.header for c in made)]]
        for i, t in enumerate(self.start + step * TIME):
            rows.append([f"{t:.0f}" if self.start else f"{t:.9g}", *self.texts.values()])
            rows[-1] += [f"{c.value[i]:.9g}" for c in made]
        return "".join(self.separator.join(row) + "\n" for row in rows)


def many(pattern, kind, unit="", *, count=0, order=(), first=0):
    """A column per joint; ``{n}`` in the pattern is the joint's own name."""

    def columns(names):
        for k, joint in enumerate(order or range(first, first + (count or len(names)))):
            name = names[joint] if joint < len(names) else f"joint_{joint}"
            number = k if order else joint
            header = pattern.replace("{0}", str(number)).replace("{1}", str(number + 1)).replace("{n}", name)
            yield column(header, kind, joint, name, unit)

    return columns


def column(header, kind, joint, name, unit=""):
    if kind is None:
        return Made(header, signal("a", joint % 8) + 3.0)
    base = unit or {"tau": "N m", "current": "A"}.get(kind, "rad")
    quantity, told = "tau" if kind == "current" else kind, kind.removesuffix("_cmd")
    value = signal(told, joint) * (0.2 if base in ("m", "mm", "N") and kind == "q" else 1.0) * FACTORS[base]
    return Made(header, value, f"{quantity}.{name}", base + PER.get(told, ""))


def named(headers, kind, unit="", joints=range(10)):
    """Columns with headers of their own, for the joints in their order, or for some."""
    places = list(zip((header.strip() for header in headers.split("|")), joints, strict=False))
    return lambda names: [column(header, kind, j, (*names, *[""] * 10)[j], unit) for header, j in places]


def beside(*headers):
    """Columns that are none of a joint."""
    return lambda _: [Made(header, signal("a", i % 8) + 2.0) for i, header in enumerate(headers)]


def all_of(*parts):
    return lambda names: [made for part in parts for made in part(names)]


def pendulum(**columns):
    """By channel: header and unit."""
    values = {
        "gripper_x": 0.08 * np.sin(4 * TIME), "gripper_v": 0.32 * np.cos(4 * TIME), "swing_angle": 0.3 * np.cos(5 * TIME),
        "swing_rate": -1.5 * np.sin(5 * TIME), "load_force": 0.8 + 0.1 * np.cos(10 * TIME),
    }  # fmt: skip
    return lambda _: [
        Made(header, values[channel] * FACTORS[unit.partition("/")[0]], channel, unit)
        for channel, (header, unit) in columns.items()
    ]


def wrench(header, sensor, units="N N_m"):
    """A column per axis of a force/torque sensor: by its number, its name, or its quantity and letter."""

    def made(_):
        names = [f"{kind}{letter}" for kind in "ft" for letter in "xyz"]
        long = [f"{kind}.{letter}" for kind in ("force", "torque") for letter in "xyz"]
        each = enumerate(zip(names, long, strict=True))
        return [
            Made(
                header.format(i, i + 1, name.capitalize(), units.split()[i // 3], text),
                3 * np.sin(TIME + i),
                f"{name}.{sensor}",
                "N" if i < 3 else "N m",
            )
            for i, (name, text) in each
        ]

    return made


def turned(header):
    """A swing that is counted from the upright."""
    return lambda _: [Made(header, np.pi + 0.3 * np.cos(5 * TIME), "swing_angle", "rad")]


RTDE = all_of(
    many("target_q_{0}", None), many("target_qd_{0}", None), many("target_qdd_{0}", None),
    many("target_current_{0}", None), many("target_moment_{0}", None), many("actual_q_{0}", "q"),
    many("actual_qd_{0}", "v"), many("actual_current_{0}", "current"), many("joint_control_output_{0}", None),
    many("actual_TCP_pose_{0}", None), many("actual_TCP_speed_{0}", None), wrench("actual_TCP_force_{0}", "tcp"),
    many("joint_temperatures_{0}", None), many("actual_joint_voltage_{0}", None),
    beside("robot_mode", "safety_mode", "speed_scaling", "actual_momentum", "actual_main_voltage", "actual_robot_current"),
    many("elbow_position_{0}", None, count=3), many("elbow_velocity_{0}", None, count=3),
    many("tool_accelerometer_{0}", None, count=3),
)  # fmt: skip
ATI = all_of(many("q{1}", "q"), wrench("{2} ({3})", "ft", "N Nm"))
JOINT_STATE = "/joint_states/{n}/"
STATE_NAMES = {f"field.name{i}": UR[j] for i, j in enumerate(ALPHABET)}

LAYOUTS = [
    Layout("ur_rtde's recorder", UR5, RTDE),
    Layout("UR's RTDE client, blanks between cells", UR5, all_of(many("actual_q_{0}", "q"), many("actual_qd_{0}", "v"), many("actual_current_as_torque_{0}", "tau"), many("target_moment_{0}", None)), separator=" "),
    Layout("UR5e, a script over RTDE", UR5, all_of(many("q{1}", "q"), many("qd{1}", "v"), beside("x", "y", "z", "R_x", "R_y", "R_z", "V_x", "V_y", "V_z", "omega_x", "omega_y", "omega_z"), many("actualI{1}", "current")), time="time"),
    Layout("UR5e, raw wrench beside the joints", UR5, all_of(many("actual_q_{0}", "q"), wrench("ft_raw_wrench_{0}", "ft"))),
    Layout("rosbag to CSV, joint states beside a wrench", UR5, all_of(many("position_{0}", "q"), wrench("wrench.{4}", "ft"))),
    Layout("ATI's data acquisition beside a UR's joints", UR5, ATI),
    Layout("UR5e, targets as tq", UR5, all_of(many("q_{0}", "q"), many("qd_{0}", "v"), many("tq_{0}", None), many("tqd_{0}", None), many("tcp_{0}", None), many("tcps_{0}", None), many("tcpf_{0}", None)), time="pc_ts"),
    Layout("UR over the dashboard", UR5, all_of(many("target_acceleration_{0}", None), many("target_position_{0}", None), many("actual_position_{0}", "q"), many("target_torque_{0}", None), many("actual_velocity_{0}", "v"), many("motor_temp_{0}", None), many("external_torque_{0}", None), many("joint_voltage_{0}", None), many("current_window_max_{0}", None), many("actual_current_{0}", "current"), many("actual_pose_{0}", None)), time="robot_epoch"),
    Layout("UR, the maker's names of its joints", UR5, all_of(named("Base position (deg)|Shoulder position (deg)|Elbow position (deg)|Wrist 1 position (deg)|Wrist 2 position (deg)|Wrist 3 position (deg)", "q", "deg"), named("Base current (A)|Shoulder current (A)|Elbow current (A)|Wrist 1 current (A)|Wrist 2 current (A)|Wrist 3 current (A)", "current")), time="Time (s)"),
    Layout("UR10e, identification", UR5, all_of(many("q{1}", "q"), many("qd{1}", "v"), many("i{1}", "current"), many("i_des{1}", None), many("tau_des{1}", None)), time="t"),
    Layout("bagpy", UR5, all_of(beside("header.seq"), many("position_{0}", "q", order=ALPHABET), many("velocity_{0}", "v", order=ALPHABET), many("effort_{0}", "current", order=ALPHABET)), time="Time", start=1.7e9 * 0, texts={f"name_{i}": UR[j] for i, j in enumerate(ALPHABET)}),
    Layout("rostopic echo -p", UR5, all_of(beside("field.header.seq"), many("field.position{0}", "q", order=ALPHABET), many("field.velocity{0}", "v", order=ALPHABET), many("field.effort{0}", "current", order=ALPHABET)), time="%time", unit="ns", start=1.7e18, texts=STATE_NAMES),
    Layout("rostopic echo -p without the names", UR5, all_of(many("field.position{0}", "q", order=ALPHABET), many("field.velocity{0}", "v", order=ALPHABET), many("field.effort{0}", "current", order=ALPHABET)), time="%time", unit="ns", start=1.7e18),
    Layout("PlotJuggler", UR5, all_of(many(f"{JOINT_STATE}position", "q"), many(f"{JOINT_STATE}velocity", "v"), many(f"{JOINT_STATE}effort", "current")), time="__time"),
    Layout("PlotJuggler, arrays", UR5, all_of(many("/joint_states/position[{0}]", "q", order=ALPHABET), many("/joint_states/velocity[{0}]", "v", order=ALPHABET), many("/joint_states/effort[{0}]", "current", order=ALPHABET)), time="__time"),
    Layout("a ROS 2 bag by a script", PANDA, all_of(many("{n}_pos", "q"), many("{n}_vel", "v"), many("{n}_effort", "tau"))),
    Layout("rosbags to CSV, slashes", PANDA, all_of(many("/joint_states/position/{n}", "q"), many("/joint_states/velocity/{n}", "v"), many("/joint_states/effort/{n}", "tau")), time="time"),
    Layout("joint recorder, names only", PANDA, many("{n}", "q"), time="t"),
    Layout("UR with a prefix", UR5, all_of(many("left_{n}_position", "q"), many("left_{n}_velocity", "v")), time="time"),
    Layout("UR in capitals", UR5, named("|".join(f"{name.upper()}_POS_DEG" for name in UR), "q", "deg"), time="TIME_MS", unit="ms"),
    Layout("MATLAB table", UR5, all_of(many("q_{1}", "q"), many("dq_{1}", "v"), many("ddq_{1}", "a"), many("tau_{1}", "tau")), time="t"),
    Layout("MATLAB, dots", ABB, all_of(many("theta{1}", "q"), many("theta{1}_dot", "v"), many("theta{1}_ddot", "a"), many("tau{1}", "tau")), time="Time"),
    Layout("MATLAB, desired besides", ABB, all_of(many("q{1}", "q"), many("q{1}_des", "q_cmd"), many("qdot{1}", "v"), many("qdot{1}_des", "v_cmd"), many("u{1}", None)), time="Time"),
    Layout("libfranka's log", PANDA, all_of(beside("success_rate"), many("state.q[{0}]", "q"), many("state.q_d[{0}]", None), many("state.dq[{0}]", "v"), many("state.dq_d[{0}]", None), many("state.tau_J[{0}]", "tau"), many("state.tau_ext_hat_filtered[{0}]", None), many("cmd.q_d[{0}]", None), many("cmd.dq_d[{0}]", None), many("cmd.O_T_EE_d[{0}]", None, count=8), many("cmd.tau_J_d[{0}]", None)), time="time", unit="ms"),
    Layout("Panda with its fingers", PANDA, all_of(many("{n}_position", "q"), many("{n}_velocity", "v"), many("{n}_effort", "tau"), beside("panda_finger_joint1_position", "panda_finger_joint2_position", "panda_finger_joint1_effort"))),
    Layout("Panda, short names", PANDA, all_of(many("q{1}", "q"), many("dq{1}", "v"), many("tau_J_{1}", "tau"), many("tau_ext_{1}", None)), time="t"),
    Layout("panda-py", PANDA, all_of(many("q_{0}", "q"), many("dq_{0}", "v"), many("tau_J_{0}", "tau"), many("tau_ext_hat_filtered_{0}", None), many("O_T_EE_{0}", None, count=8)), time="time"),
    Layout("polymetis", PANDA, all_of(many("joint_positions_{0}", "q"), many("joint_velocities_{0}", "v"), many("motor_torques_measured_{0}", "tau"), many("motor_torques_external_{0}", None), many("motor_torques_desired_{0}", None)), time="timestamp"),
    Layout("franka_ros2's names on a Panda", PANDA, all_of(many("fer_joint{1}_position", "q"), many("fer_joint{1}_effort", "tau"))),
    Layout("robosuite", PANDA, all_of(many("robot0_joint_pos_{0}", "q"), many("robot0_joint_vel_{0}", "v"), beside("robot0_gripper_qpos_0", "robot0_gripper_qpos_1", "robot0_eef_pos_0", "robot0_eef_pos_1", "robot0_eef_pos_2")), time="time"),
    Layout("DROID", PANDA, all_of(many("observation/robot_state/joint_positions/{0}", "q"), many("observation/robot_state/joint_velocities/{0}", "v"), many("observation/robot_state/joint_torques_computed/{0}", None), many("action/joint_position/{0}", "q_cmd"), beside("observation/robot_state/gripper_position", "observation/robot_state/cartesian_position/0"))),
    Layout("MuJoCo's sensors", PANDA, all_of(many("{n}_position", "q"), many("{n}_velocity", "v"), many("{n}_torque", "tau"), beside("wrist_force_x", "wrist_force_y", "wrist_torque_z")), time="time"),
    Layout("Isaac, fingers counted", PANDA, all_of(many("dof_pos_{0}", "q"), many("dof_vel_{0}", "v"), many("dof_torque_{0}", "tau"), beside("dof_pos_7", "dof_pos_8", "dof_vel_7", "dof_vel_8", "dof_torque_7", "dof_torque_8")), time="time"),
    Layout("seven of eight joints", robot(["rail", *(f"j{i}" for i in range(1, 8))]), named("q1|q2|q3|q4|q5|q6|q7", "q", joints=range(1, 8)), time="t"),
    Layout("the last joint is missing", GEN3, all_of(many("q{1}", "q", count=6), many("tau{1}", "tau", count=6)), time="t"),
    Layout("the first joint is missing", GEN3, all_of(many("q{1}", "q", count=6, first=1), many("tau{1}", "tau", count=6, first=1)), time="t"),
    Layout("KUKA's variables", KUKA, all_of(many("Position_Command_A{1}", None), many("Position_A{1}", "q", "deg"), many("Torque_A{1}", "tau"), many("Current_A{1}", None), many("Temperature_A{1}", None), many("A{1}", None), beside("Queue_Read", "Queue_Write", "Load")), time="Sample_time", unit="ms"),
    Layout("KUKA, motor currents in mA", KUKA, all_of(many("Axis{1}_Position_deg", "q", "deg"), many("Axis{1}_Velocity_deg_s", "v", "deg"), many("Axis{1}_MotCurrent_mA", "current", "mA")), time="Time_s"),
    Layout("KUKA's trace in German", KUKA, all_of(many("sollposition_{1}", None), many("istposition_{1}", "q", "deg"), many("sollmoment_{1}", None), many("istmoment_{1}", "tau")), time="zeit"),
    Layout("KUKA RSI", KUKA, all_of(many("AIPos.A{1}", "q", "deg"), many("ASPos.A{1}", None), many("MACur.A{1}", "current")), time="time", unit="ms"),
    Layout("pyfri", IIWA, all_of(beside("index"), many("mp{1}", "q"), many("ip{1}", None), many("mt{1}", "tau"), many("et{1}", None)), time="time"),
    Layout("Sunrise's recorder", IIWA, all_of(many("axisQMsr_LBR_iiwa_7_R800_1_J{1} [rad]", "q"), many("axisTauMsr_LBR_iiwa_7_R800_1_J{1} [Nm]", "tau")), time="ZeitInSec"),
    Layout("Drake's iiwa status", IIWA, all_of(many("joint_position_measured_{0}", "q"), many("joint_position_commanded_{0}", None), many("joint_position_ipo_{0}", None), many("joint_velocity_estimated_{0}", "v"), many("joint_torque_measured_{0}", "tau"), many("joint_torque_commanded_{0}", None), many("joint_torque_external_{0}", None)), time="utime", unit="us"),
    Layout("ABB, joints only", ABB, all_of(beside("cmdnum"), many("J{1}", "q", "deg")), time="timestamp"),
    Layout("two ABB arms", ABB, all_of(beside("cmdnum"), many("J{1}", "q", "deg"), many("J{1}_2", None)), time="timestamp"),
    Layout("ABB EGM", ABB, all_of(many("joint{1}_feedback", "q", "deg"), many("joint{1}_planned", None)), time="time", unit="ms"),
    Layout("ABB, signals of the motors", ABB, all_of(many("J{1} Motor Torque [Nm]", "tau"), many("J{1} Speed [deg/s]", "v", "deg"), many("J{1} Position [deg]", "q", "deg"), many("J{1} Near limit", None)), time="Time [s]", separator=";"),
    Layout("Kortex", GEN3, all_of(many("position_{1}", "q", "deg"), many("velocity_{1}", "v", "deg"), many("torque_{1}", "tau"), many("current_motor_{1}", None), many("voltage_{1}", None), many("temperature_motor_{1}", None), many("temperature_core_{1}", None), beside("tool_pose_x", "tool_pose_y", "tool_pose_theta_x")), time="timestamp", unit="us"),
    Layout("Gen3, identification", GEN3, all_of(many("AngleJ{1}", "q"), many("VelocityJ{1}", "v"), many("TorqueCurJ{1}", "tau"), many("TorqueSmJ{1}", None)), time="Time"),
    Layout("Jaco with its fingers", JACO, all_of(many("{n}_pos", "q"), many("{n}_vel", "v"), many("{n}_eff", None), beside(*(f"j2s6s200_joint_finger_{i}_pos" for i in (1, 2, 3)))), time="time"),
    Layout("xArm's SDK", XARM, all_of(many("joint{1}_angle_deg", "q", "deg"), many("joint{1}_speed_deg_s", "v", "deg"), many("joint{1}_torque_Nm", "tau")), time="time_s"),
    Layout("xArm, units between words", XARM, all_of(many("pos_rad_{1}", "q"), many("vel_rad_per_s_{1}", "v"), many("current_A_{1}", "current")), time="t_ms", unit="ms"),
    Layout("xArm's messages by name", XARM, all_of(many("{n}/position", "q"), many("{n}/velocity", "v"), many("{n}/effort", "tau"), beside("drive_joint/position", "drive_joint/effort"))),
    Layout("LeRobot SO-101", SO, all_of(many("observation.state/{n}.pos", "q", "deg"), many("action/{n}.pos", "q_cmd", "deg"), beside("observation.state/gripper.pos", "action/gripper.pos"))),
    Layout("LeRobot, first names", SO, all_of(many("observation.state/main_{n}", "q", "deg"), many("action/main_{n}", "q_cmd", "deg"), beside("observation.state/main_gripper"))),
    Layout("LeRobot, motors counted", ABB, all_of(many("observation.state/{0}", "q"), many("action/{0}", "q_cmd"))),
    Layout("LIBERO", PANDA, all_of(many("observation.states.joint_state/joint_{0}", "q"), beside(*(f"observation.state/{c}" for c in ("x", "y", "z", "roll", "pitch", "yaw", "gripper")), *(f"action/{c}" for c in "xyz")))),
    Layout("ALOHA, two arms and one robot", ALOHA, all_of(many("observation.state/left_{n}", "q"), many("observation.state/right_{n}", None), many("observation.effort/left_{n}", "tau"), beside("observation.state/left_gripper"))),
    Layout("voraus", ABB, all_of(many("target_position_{1}", None), many("target_torque_{1}", None), many("computed_inertia_{1}", None), many("computed_torque_{1}", None), many("motor_position_{1}", None), many("motor_velocity_{1}", None), many("joint_position_{1}", "q"), many("joint_velocity_{1}", "v"), many("motor_torque_{1}", None), many("torque_sensor_a_{1}", "tau"), many("torque_sensor_b_{1}", None), many("motor_iq_{1}", None), many("motor_id_{1}", None), many("power_motor_el_{1}", None)), time="time"),
    Layout("Fanuc", ABB, all_of(many("J{1} Actual Position(deg)", "q", "deg"), many("J{1} Command Position(deg)", None), many("J{1} Torque(Nm)", "tau"), many("J{1} Disturbance torque(Nm)", None)), time="Time(ms)", unit="ms"),
    Layout("Motoman's letters", MOTOMAN, all_of(named("S pos (deg)|L pos (deg)|U pos (deg)|R pos (deg)|B pos (deg)|T pos (deg)", "q", "deg")), time="Time (s)"),
    Layout("Stäubli, identification", ABB, all_of(many("Position{1}", "q"), many("Speed{1}", "v"), many("Torque{1}", "tau")), time="Time"),
    Layout("Schunk", ABB, all_of(many("Angle joint {1}", "q"), many("Angular velocity joint {1}", "v"), many("Motor torque joint {1}", "tau")), time="time"),
    Layout("Baxter, both arms", BAXTER, all_of(many("{n}_position", "q"), many("{n}_effort", "tau"), lambda _: [column(f"left_{j}_position", "q", i, f"left_{j}") for i, j in enumerate(("s0", "s1", "e0", "e1", "w0", "w1", "w2"))]), time="time"),
    Layout("Baxter, arm not named", BAXTER, all_of(many("q_{0}", "q"), many("tau_{0}", "tau")), time="time"),
    Layout("EMPS", SLIDE, all_of(named("qm", "q", "m"), beside("qg", "vir")), time="t"),
    Layout("double pendulum", DOUBLE, all_of(many("pos_meas{1}", "q"), many("vel_meas{1}", "v"), many("tau_meas{1}", "tau"), many("pos_des{1}", None), many("tau_des{1}", None)), time="time"),
    Layout("SARCOS", robot([f"a{i}" for i in range(1, 8)]), many("V{1}", None, count=28), time="t"),
    Layout("speeds of other joints", ABB, all_of(many("q{1}", "q"), named("qd1|qd2|qd3|qd4|qd5|qd6", None)), time="t"),
    Layout("positions from 1, torques from 0", PANDA, all_of(many("q{1}", "q"), many("tau{0}", "tau")), time="t"),
    Layout("a robot that counts from 0", robot([f"joint_{i}" for i in range(6)]), all_of(many("joint{1}_pos", "q"), many("joint{1}_torque", "tau")), time="t"),
    Layout("revolutions per minute, not said", ABB, all_of(many("joint{1}_position_deg", "q", "deg"), lambda _: [Made(f"joint{i}_speed", 9.549 * signal("v", i - 1)) for i in range(1, 7)]), time="t"),
    Layout("degrees that call themselves rad", ABB, lambda _: [Made(f"joint{i}_position [rad]", 57.3 * signal("q", i - 1)) for i in range(1, 7)], time="t [s]"),
    Layout("Pinocchio's letters", PANDA, all_of(many("q_{0}", "q"), many("v_{0}", "v"), many("a_{0}", "a"), many("tau_{0}", "tau")), time="t"),
    Layout("torques in mN m", ABB, all_of(many("joint{1}_pos_rad", "q"), many("joint{1}_torque_mNm", "tau", "mN m")), time="time"),
    Layout("torques in mN m, not said", ABB, all_of(many("joint{1}_pos_rad", "q"), many("joint{1}_torque", "tau", "mN m")), time="time"),
    Layout("Dynamixel's registers", ABB, all_of(lambda _: [Made(f"Present_Position_{i}", 2048 + 400 * signal("q", i - 1), f"q.joint_{i}", "counts") for i in range(1, 7)], many("Present_Load_{1}", None), many("Present_Voltage_{1}", None), lambda _: [Made(f"Goal_Position_{i}", 2048 + 400 * signal("q", i - 1), f"q_cmd.joint_{i}", "counts") for i in range(1, 7)]), time="time"),
    Layout("torques of six axes, numbers of two", ABB, all_of(many("J{1}", None, count=2), many("tau{1}", "tau")), time="t"),
    Layout("q_d without a dq", ABB, all_of(many("q_{1}", "q"), many("q_d_{1}", "v")), time="t"),
    Layout("whole seconds since 1970", ABB, many("q{1}", "q"), time="time", start=1.7e9),
    Layout("speeds in the unit of angles", ABB, all_of(many("joint{1}_position_deg", "q", "deg"), many("joint{1}_velocity_deg", "v", "deg")), time="t"),
    Layout("an arm without its URDF", NOBODY, lambda _: [column(f"joint{i}_{word}", kind, i - 1, f"joint{i}") for word, kind in (("pos", "q"), ("vel", "v"), ("torque", "tau")) for i in range(1, 7)], time="t"),
    Layout("UR's names without its URDF", NOBODY, lambda _: [column(f"/joint_states/{n}/{word}", kind, i, n) for word, kind in (("position", "q"), ("velocity", "v")) for i, n in enumerate(UR)], time="t"),
    Layout("Panda's names without its URDF", NOBODY, lambda _: [column(f"{n}_{word}", kind, i, n) for word, kind in (("position", "q"), ("effort", "tau")) for i, n in enumerate(PANDA.arm)], time="t"),
    Layout("angle beside the gripper", NOBODY, pendulum(gripper_x=("gripper_x", "m"), swing_angle=("angle_rad", "rad"), load_force=("load_N", "N")), time="time_s"),
    Layout("cart and pendulum", NOBODY, pendulum(gripper_x=("cart_position_mm", "mm"), gripper_v=("cart_velocity_m_s", "m/s"), swing_angle=("pend_angle_deg", "deg"), swing_rate=("pend_velocity_deg_s", "deg/s")), time="t"),
    Layout("counted from the upright", NOBODY, all_of(pendulum(gripper_x=("x", "m")), turned("theta"), pendulum(swing_rate=("theta_dot", "rad/s"))), time="t"),
    Layout("a phone's angle", NOBODY, pendulum(swing_angle=("Angle (deg)", "deg")), time="Time (s)"),
    Layout("a gyroscope", NOBODY, pendulum(swing_rate=("gyro_rad_s", "rad/s")), time="time_ms", unit="ms"),
    Layout("load cell and trolley", NOBODY, all_of(pendulum(load_force=("Tension (N)", "N"), gripper_x=("Trolley x (mm)", "mm")), beside("trolley_setpoint")), time="Zeit", separator=";"),
    Layout("Tracker", NOBODY, pendulum(swing_angle=("theta", "rad"), swing_rate=("omega", "rad/s")), time="t", separator="\t"),
]  # fmt: skip
