"""Bases whose states are currents, angles and places, of order 2 to 6."""

import numpy as np

from . import Case, Family, beyond


def _filter(c: Case, s: np.ndarray, u: float) -> list[float]:
    i, v = s
    leak = c["diode.conductance"] * max(v - c["diode.knee"], 0.0) + c["leakage.size"] * v
    drop = c["varistor.size"] * i * abs(i)
    return [(u - v - c["resistance"] * i - drop) / c["inductance"], (i - leak) / c["capacity"]]


FILTER = Family(
    "filter", "electrical", '''
@dataclass(frozen=True)
class Node(Stage):
    voltage: Expression
    current: Expression = 0

@dataclass(frozen=True)
class Coil(Stage):
    current: Expression
    drop: Expression = 0

@physics("filter", summary="A low-pass of a coil and a capacitor.", source="Kirchhoff 1845",
    parameters=(constant("inductance", "H", 1e-3, lower=1e-6), constant("capacity", "F", 1e-5, lower=1e-8),
                constant("resistance", "ohm", 3.0, lower=1e-3)),
    states=(state("current", "A", typical=0.3), state("voltage", "V", typical=3.0)),
    inputs={"extra.source": "V"}, outputs={"extra.voltage": "V"}, held=("extra.source",), period=6e-4)
def filter_(at: Moment) -> Equations:
    i, v = at["current"], at["voltage"]
    node, coil = at.stage("node", Node(v)), at.stage("coil", Coil(i))
    return Equations(
        {"current": (at.input("extra.source").value - v - at["resistance"] * i - coil.drop) / at["inductance"],
         "voltage": (i + node.current) / at["capacity"]},
        {"extra.voltage": v})

@effect(summary="a diode to ground", source="Shockley, in pieces")
def diode(node: Node, conductance: Expression = quantity("1/ohm", typical=0.1, lower=0.0),
          knee: Expression = quantity("V", typical=1.0, null=5.0, lower=0.0)) -> Node:
    return replace(node, current=node.current - conductance * ca.fmax(node.voltage - knee, 0))

@effect(summary="the capacitor leaks", source="Ohm 1827")
def leakage(node: Node, size: Expression = quantity("1/ohm", typical=0.01, lower=0.0)) -> Node:
    return replace(node, current=node.current - size * node.voltage)

@effect(summary="the coil's loss grows with the square", source="of its own")
def varistor(coil: Coil, size: Expression = quantity("ohm/A", typical=3.0, lower=0.0)) -> Coil:
    return replace(coil, drop=coil.drop + size * coil.current * ca.fabs(coil.current))
''',
    {"inductance": 1.1e-3, "capacity": 9e-6, "resistance": 4.0},
    {"diode": {"conductance": 0.08, "knee": 5.0}, "leakage": {"size": 0.01}, "varistor": {"size": 6.0}}, _filter,
    {"extra.voltage": 1}, {"extra.voltage": 0.02}, (2.0, 6.0), 5000.0, (0.1, 1.0), 0.02, 1e5,
    "extra.source", "V", held=True,
)  # fmt: skip


def _motor(c: Case, s: np.ndarray, u: float) -> list[float]:
    i, w = s
    drag = c["fan.size"] * w * abs(w) + c["bearing.size"] * w + c["brake.torque"] * np.tanh(w / 0.05)
    return [(u - c["resistance"] * i - c["constant"] * w) / c["inductance"], (c["constant"] * i - drag) / c["inertia"]]


MOTOR = Family(
    "motor", "electromechanical", '''
@dataclass(frozen=True)
class Rotor(Stage):
    speed: Expression
    torque: Expression = 0

@physics("motor", summary="A direct-current motor.", source="Fitzgerald, Electric Machinery",
    parameters=(constant("resistance", "ohm", 1.0, lower=0.01), constant("inductance", "H", 0.02, lower=1e-5),
                constant("constant", "N m/A", 0.05, lower=1e-3), constant("inertia", "kg m^2", 1e-3, lower=1e-6)),
    states=(state("current", "A", typical=2.0), state("speed", "rad/s", typical=50.0)),
    inputs={"extra.voltage": "V"}, outputs={"extra.current": "A", "v.rotor": "rad/s"}, period=0.5)
def motor(at: Moment) -> Equations:
    i, w = at["current"], at["speed"]
    rotor = at.stage("rotor", Rotor(w))
    return Equations(
        {"current": (at.input("extra.voltage").value - at["resistance"] * i - at["constant"] * w) / at["inductance"],
         "speed": (at["constant"] * i + rotor.torque) / at["inertia"]},
        {"extra.current": i, "v.rotor": w})

@effect(summary="a fan", source="of its own")
def fan(rotor: Rotor, size: Expression = quantity("N m s^2/rad^2", typical=1e-5, lower=0.0)) -> Rotor:
    return replace(rotor, torque=rotor.torque - size * rotor.speed * ca.fabs(rotor.speed))

@effect(summary="viscous bearing", source="of its own")
def bearing(rotor: Rotor, size: Expression = quantity("N m s/rad", typical=1e-3, lower=0.0)) -> Rotor:
    return replace(rotor, torque=rotor.torque - size * rotor.speed)

@effect(summary="dry friction", source="Coulomb 1785")
def brake(rotor: Rotor, torque: Expression = quantity("N m", typical=0.02, lower=0.0)) -> Rotor:
    return replace(rotor, torque=rotor.torque - torque * ca.tanh(rotor.speed / 0.05))
''',
    {"resistance": 1.2, "inductance": 0.025, "constant": 0.06, "inertia": 1.2e-3},
    {"fan": {"size": 1.2e-5}, "bearing": {"size": 8e-4}, "brake": {"torque": 0.03}}, _motor,
    {"extra.current": 0, "v.rotor": 1},
    {"extra.current": 0.03, "v.rotor": 0.2}, (0.5, 8.0), 6.0, (0.5, 10.0), 8.0, 200.0, "extra.voltage", "V",
)  # fmt: skip


def _geared(c: Case, s: np.ndarray, u: float) -> list[float]:
    a, v, b, w = s
    twist = beyond(a / 20.0 - b, c["gear_backlash.width"])
    torque = c["stiffness"] * twist + 0.3 * (v / 20.0 - w)
    lost = c["load_drag.size"] * w + c["load_friction.torque"] * np.tanh(w / 0.02)
    return [v, (u - 2e-4 * v - torque / 20.0) / c["motor"], w, (torque - lost) / c["load"]]


GEARED = Family(
    "geared", "geared", '''
RATIO, DAMPING, BEARING = 20.0, 0.3, 2e-4

@dataclass(frozen=True)
class Gear(Stage):
    twist: Expression

@dataclass(frozen=True)
class Load(Stage):
    speed: Expression
    torque: Expression = 0

@physics("geared", summary="A motor turns a load through a gear and a shaft.", source="Spong 1987",
    parameters=(constant("motor", "kg m^2", 5e-5, lower=1e-7), constant("load", "kg m^2", 0.05, lower=1e-4),
                constant("stiffness", "N m/rad", 60.0, lower=0.1)),
    states=(state("motor_angle", "rad", typical=5.0), state("motor_speed", "rad/s", typical=20.0),
            state("load_angle", "rad", typical=0.3), state("load_speed", "rad/s", typical=1.0)),
    inputs={"tau.motor": "N m"}, outputs={"q.motor": "rad", "q.load": "rad"}, period=0.3)
def geared(at: Moment) -> Equations:
    v, w = at["motor_speed"], at["load_speed"]
    gear = at.stage("gear", Gear(at["motor_angle"] / RATIO - at["load_angle"]))
    load = at.stage("load", Load(w))
    torque = at["stiffness"] * gear.twist + DAMPING * (v / RATIO - w)
    return Equations(
        {"motor_angle": v, "motor_speed": (at.input("tau.motor").value - BEARING * v - torque / RATIO) / at["motor"],
         "load_angle": w, "load_speed": (torque + load.torque) / at["load"]},
        {"q.motor": at["motor_angle"], "q.load": at["load_angle"]})

@effect(summary="backlash", source="Nordin & Gutman, Automatica 38, 2002")
def gear_backlash(gear: Gear, width: Expression = quantity("rad", typical=0.01, lower=0.0)) -> Gear:
    return replace(gear, twist=gear.twist - ca.fmax(ca.fmin(gear.twist, width), -width))

@effect(summary="viscous friction of the load", source="of its own")
def load_drag(load: Load, size: Expression = quantity("N m s/rad", typical=0.05, lower=0.0)) -> Load:
    return replace(load, torque=load.torque - size * load.speed)

@effect(summary="dry friction of the load", source="Coulomb 1785")
def load_friction(load: Load, torque: Expression = quantity("N m", typical=0.1, lower=0.0)) -> Load:
    return replace(load, torque=load.torque - torque * ca.tanh(load.speed / 0.02))
''',
    {"motor": 5e-5, "load": 0.05, "stiffness": 60.0},
    {"gear_backlash": {"width": 0.008}, "load_drag": {"size": 0.08}, "load_friction": {"torque": 0.15}}, _geared,
    {"q.motor": 0, "q.load": 2}, {"q.motor": 5e-3, "q.load": 3e-4},
    (0.0, 0.03), 8.0, (1.0, 5.0, 0.05, 0.25), 6.0, 250.0, "tau.motor", "N m",
)  # fmt: skip


def _masses(c: Case, s: np.ndarray, u: float) -> list[float]:
    x, v, y, w = s
    pull = c["spring"] * (x - y) + c["damper"] * (v - w) + c["hardening.size"] * (x - y) ** 3
    less = c["end_stop.stiffness"] * max(x - c["end_stop.place"], 0.0) + c["air_drag.size"] * v * abs(v)
    return [v, (u - pull - less) / c["first"], w, (pull - 40.0 * y) / c["second"]]


MASSES = Family(
    "masses", "mechanical", '''
@dataclass(frozen=True)
class Slide(Stage):
    place: Expression
    speed: Expression
    force: Expression = 0

@dataclass(frozen=True)
class Spring(Stage):
    stretch: Expression
    force: Expression

@physics("masses", summary="Two masses and two springs.", source="Thomson, Theory of Vibration",
    parameters=(constant("first", "kg", 1.0, lower=0.01), constant("second", "kg", 2.0, lower=0.01),
                constant("spring", "N/m", 60.0, lower=0.1), constant("damper", "N s/m", 0.5, lower=0.0)),
    states=(state("x", "m", typical=0.1), state("x_speed", "m/s", typical=0.5),
            state("y", "m", typical=0.1), state("y_speed", "m/s", typical=0.5)),
    inputs={"tau.push": "N"}, outputs={"q.first": "m"}, period=1.0)
def masses(at: Moment) -> Equations:
    x, v, y, w = at["x"], at["x_speed"], at["y"], at["y_speed"]
    pull = at.stage("spring", Spring(x - y, at["spring"] * (x - y) + at["damper"] * (v - w))).force
    slide = at.stage("slide", Slide(x, v))
    return Equations(
        {"x": v, "x_speed": (at.input("tau.push").value - pull + slide.force) / at["first"],
         "y": w, "y_speed": (pull - 40.0 * y) / at["second"]},
        {"q.first": x})

@effect(summary="a spring that hardens", source="Duffing 1918")
def hardening(spring: Spring, size: Expression = quantity("N/m^3", typical=1000.0)) -> Spring:
    return replace(spring, force=spring.force + size * spring.stretch**3)

@effect(summary="an end stop", source="of its own")
def end_stop(slide: Slide, stiffness: Expression = quantity("N/m", typical=100.0, lower=0.0),
             place: Expression = quantity("m", typical=0.05, null=0.2, lower=0.0)) -> Slide:
    return replace(slide, force=slide.force - stiffness * ca.fmax(slide.place - place, 0))

@effect(summary="air drag", source="Newton 1687")
def air_drag(slide: Slide, size: Expression = quantity("N s^2/m^2", typical=1.0, lower=0.0)) -> Slide:
    return replace(slide, force=slide.force - size * slide.speed * ca.fabs(slide.speed))
''',
    {"first": 1.0, "second": 2.0, "spring": 60.0, "damper": 0.5},
    {"hardening": {"size": 1500.0}, "end_stop": {"stiffness": 200.0, "place": 0.12}, "air_drag": {"size": 1.5}},
    _masses,
    {"q.first": 0}, {"q.first": 5e-4}, (1.0, 5.0), 6.0, (0.1, 0.3, 0.05, 0.2), 15.0, 100.0,
    "tau.push", "N",
)  # fmt: skip


def _cart(c: Case, s: np.ndarray, u: float) -> list[float]:
    _, v, a, w = s
    more, turn = -c["rail.size"] * v - c["rail_friction.force"] * np.tanh(v / 0.02), -c["pivot.size"] * w
    m, length, M = c["pole"], c["length"], c["cart"]
    A = np.array([[M + m, m * length * np.cos(a)], [m * length * np.cos(a), m * length**2]])
    acc = np.linalg.solve(A, [u + more + m * length * w * w * np.sin(a), -m * 9.81 * length * np.sin(a) + turn])
    return [v, acc[0], w, acc[1]]


CART = Family(
    "cart", "mechanical", '''
@dataclass(frozen=True)
class Rail(Stage):
    speed: Expression
    force: Expression = 0

@dataclass(frozen=True)
class Pivot(Stage):
    rate: Expression
    torque: Expression = 0

@physics("cart", summary="A pole hangs from a cart that is pushed.", source="Cannon, Dynamics of Physical Systems",
    parameters=(constant("cart", "kg", 1.0, lower=0.01), constant("pole", "kg", 0.3, lower=0.01),
                constant("length", "m", 0.5, lower=0.01)),
    states=(state("place", "m", typical=0.3), state("speed", "m/s", typical=1.0),
            state("angle", "rad", typical=0.5), state("rate", "rad/s", typical=2.0)),
    inputs={"tau.push": "N"}, outputs={"q.cart": "m", "q.pole": "rad"}, period=1.5)
def cart(at: Moment) -> Equations:
    v, a, w, l, m, M = at["speed"], at["angle"], at["rate"], at["length"], at["pole"], at["cart"]
    rail, pivot = at.stage("rail", Rail(v)), at.stage("pivot", Pivot(w))
    mass = ca.vertcat(ca.horzcat(M + m, m * l * ca.cos(a)), ca.horzcat(m * l * ca.cos(a), m * l**2))
    force = ca.vertcat(at.input("tau.push").value + rail.force + m * l * w**2 * ca.sin(a),
                       pivot.torque - m * 9.81 * l * ca.sin(a))
    faster = ca.solve(mass, force)
    return Equations({"place": v, "speed": faster[0], "angle": w, "rate": faster[1]},
                     {"q.cart": at["place"], "q.pole": a})

@effect(summary="viscous friction of the rail", source="of its own")
def rail(rail: Rail, size: Expression = quantity("N s/m", typical=0.3, lower=0.0)) -> Rail:
    return replace(rail, force=rail.force - size * rail.speed)

@effect(summary="dry friction of the rail", source="Coulomb 1785")
def rail_friction(rail: Rail, force: Expression = quantity("N", typical=0.3, lower=0.0)) -> Rail:
    return replace(rail, force=rail.force - force * ca.tanh(rail.speed / 0.02))

@effect(summary="friction of the pivot", source="of its own")
def pivot(pivot: Pivot, size: Expression = quantity("N m s/rad", typical=0.01, lower=0.0)) -> Pivot:
    return replace(pivot, torque=pivot.torque - size * pivot.rate)
''',
    {"cart": 1.0, "pole": 0.3, "length": 0.5},
    {"rail": {"size": 0.4}, "rail_friction": {"force": 0.4}, "pivot": {"size": 0.01}}, _cart,
    {"q.cart": 0, "q.pole": 2}, {"q.cart": 5e-4, "q.pole": 2e-3}, (0.0, 2.0), 4.0,
    (0.1, 0.1, 0.5, 0.5), 12.0, 100.0, "tau.push", "N",
)  # fmt: skip


def _double(c: Case, s: np.ndarray, _: float) -> list[float]:
    a, v, b, w = s
    l1, l2, r = c["upper"], c["lower"], c["masses"]
    t2 = -c["elbow.size"] * (w - v)
    t1 = -t2 - c["shoulder.size"] * v - c["shoulder_friction.torque"] * np.tanh(v / 0.05)
    d = a - b
    A = np.array([[(1 + r) * l1**2, r * l1 * l2 * np.cos(d)], [r * l1 * l2 * np.cos(d), r * l2**2]])
    f = [-r * l1 * l2 * w**2 * np.sin(d) - (1 + r) * 9.81 * l1 * np.sin(a) + t1,
         r * l1 * l2 * v**2 * np.sin(d) - r * 9.81 * l2 * np.sin(b) + t2]  # fmt: skip
    acc = np.linalg.solve(A, f)
    return [v, acc[0], w, acc[1]]


DOUBLE = Family(
    "double", "mechanical", '''
@dataclass(frozen=True)
class Hinge(Stage):
    rate: Expression
    torque: Expression = 0

@physics("double", summary="Two pendulums, one below the other; torques over the upper mass.", source="Goldstein",
    parameters=(constant("upper", "m", 0.3, lower=0.01), constant("lower", "m", 0.3, lower=0.01),
                constant("masses", "1", 1.0, lower=0.01)),
    states=(state("a", "rad", typical=0.5), state("a_rate", "rad/s", typical=3.0),
            state("b", "rad", typical=0.5), state("b_rate", "rad/s", typical=3.0)),
    outputs={"q.upper": "rad", "q.lower": "rad"}, period=1.0)
def double(at: Moment) -> Equations:
    a, v, b, w = at["a"], at["a_rate"], at["b"], at["b_rate"]
    m, n, r = at["upper"], at["lower"], at["masses"]
    first, second = at.stage("shoulder", Hinge(v)).torque, at.stage("elbow", Hinge(w - v)).torque
    d = a - b
    mass = ca.vertcat(ca.horzcat((1 + r) * m**2, r * m * n * ca.cos(d)), ca.horzcat(r * m * n * ca.cos(d), r * n**2))
    force = ca.vertcat(
        first - second - r * m * n * w**2 * ca.sin(d) - (1 + r) * 9.81 * m * ca.sin(a),
        second + r * m * n * v**2 * ca.sin(d) - r * 9.81 * n * ca.sin(b))
    faster = ca.solve(mass, force)
    return Equations({"a": v, "a_rate": faster[0], "b": w, "b_rate": faster[1]}, {"q.upper": a, "q.lower": b})

@effect("shoulder", "shoulder", summary="viscous friction above", source="of its own")
def shoulder(hinge: Hinge, size: Expression = quantity("m^2/s", typical=0.01, lower=0.0)) -> Hinge:
    return replace(hinge, torque=hinge.torque - size * hinge.rate)

@effect("elbow", "elbow", summary="viscous friction between", source="of its own")
def elbow(hinge: Hinge, size: Expression = quantity("m^2/s", typical=0.01, lower=0.0)) -> Hinge:
    return replace(hinge, torque=hinge.torque - size * hinge.rate)

@effect("shoulder_friction", "shoulder", summary="dry friction above", source="Coulomb 1785")
def shoulder_friction(hinge: Hinge, torque: Expression = quantity("m^2/s^2", typical=0.02, lower=0.0)) -> Hinge:
    return replace(hinge, torque=hinge.torque - torque * ca.tanh(hinge.rate / 0.05))
''',
    {"upper": 0.3, "lower": 0.25, "masses": 0.8},
    {"shoulder": {"size": 0.01}, "elbow": {"size": 0.006}, "shoulder_friction": {"torque": 0.03}}, _double,
    {"q.upper": 0, "q.lower": 2}, {"q.upper": 2e-3, "q.lower": 2e-3}, (0.0, 0.0),
    1.0, (0.6, 0.5, -0.5, 0.5), 10.0, 100.0, "", "",
)  # fmt: skip


def _train(c: Case, s: np.ndarray, u: float) -> list[float]:
    a, v, b, w, d, z = s
    first = c["first_shaft"] * (a - b) + 0.02 * (v - w)
    second = c["second_shaft"] * beyond(b - d, c["coupling_backlash.width"]) + 0.02 * (w - z)
    lost = c["end_drag.size"] * z + c["end_fan.size"] * z * abs(z)
    return [v, (u - first - 0.01 * v) / c["motor"], w, (first - second) / c["middle"], z, (second - lost) / c["end"]]


TRAIN = Family(
    "train", "geared", '''
@dataclass(frozen=True)
class Coupling(Stage):
    twist: Expression

@dataclass(frozen=True)
class End(Stage):
    speed: Expression
    torque: Expression = 0

@physics("train", summary="Three discs on two shafts.", source="ECP Model 205 manual",
    parameters=(constant("motor", "kg m^2", 0.01, lower=1e-5), constant("middle", "kg m^2", 0.01, lower=1e-5),
                constant("end", "kg m^2", 0.01, lower=1e-5), constant("first_shaft", "N m/rad", 3.0, lower=0.01),
                constant("second_shaft", "N m/rad", 3.0, lower=0.01)),
    states=(state("a", "rad", typical=1.0), state("a_rate", "rad/s", typical=3.0),
            state("b", "rad", typical=1.0), state("b_rate", "rad/s", typical=3.0),
            state("c", "rad", typical=1.0), state("c_rate", "rad/s", typical=3.0)),
    inputs={"tau.motor": "N m"}, outputs={"q.motor": "rad", "q.end": "rad"}, period=0.6)
def train(at: Moment) -> Equations:
    v, w, z = at["a_rate"], at["b_rate"], at["c_rate"]
    first = at["first_shaft"] * (at["a"] - at["b"]) + 0.02 * (v - w)
    coupling = at.stage("coupling", Coupling(at["b"] - at["c"]))
    second = at["second_shaft"] * coupling.twist + 0.02 * (w - z)
    end = at.stage("end", End(z))
    return Equations(
        {"a": v, "a_rate": (at.input("tau.motor").value - first - 0.01 * v) / at["motor"],
         "b": w, "b_rate": (first - second) / at["middle"], "c": z, "c_rate": (second + end.torque) / at["end"]},
        {"q.motor": at["a"], "q.end": at["c"]})

@effect(summary="backlash of the coupling", source="Nordin & Gutman, Automatica 38, 2002")
def coupling_backlash(coupling: Coupling, width: Expression = quantity("rad", typical=0.02, lower=0.0)) -> Coupling:
    return replace(coupling, twist=coupling.twist - ca.fmax(ca.fmin(coupling.twist, width), -width))

@effect(summary="viscous friction at the end", source="of its own")
def end_drag(end: End, size: Expression = quantity("N m s/rad", typical=0.01, lower=0.0)) -> End:
    return replace(end, torque=end.torque - size * end.speed)

@effect(summary="a fan at the end", source="of its own")
def end_fan(end: End, size: Expression = quantity("N m s^2/rad^2", typical=0.003, lower=0.0)) -> End:
    return replace(end, torque=end.torque - size * end.speed * ca.fabs(end.speed))
''',
    {"motor": 0.012, "middle": 0.01, "end": 0.011, "first_shaft": 3.0, "second_shaft": 2.5},
    {"coupling_backlash": {"width": 0.03}, "end_drag": {"size": 0.01}, "end_fan": {"size": 0.003}}, _train,
    {"q.motor": 0, "q.end": 4}, {"q.motor": 2e-3, "q.end": 2e-3}, (0.0, 0.6), 6.0,
    (0.5, 0.5, 0.5, 0.5, 0.5, 0.5), 8.0, 200.0, "tau.motor", "N m",
)  # fmt: skip


def _hydraulic(c: Case, s: np.ndarray, u: float) -> list[float]:
    x, v, p = s
    flow = c["valve"] * beyond(u, c["valve_dead_zone.width"]) - 1e-3 * v - c["inner_leak.size"] * p
    return [v, (1e-3 * p - c["spring"] * x - c["seal.size"] * v) / c["mass"], c["bulk"] * flow]


CYLINDER = Family(
    "cylinder", "hydraulic", '''
AREA = 1e-3

@dataclass(frozen=True)
class Valve(Stage):
    opening: Expression

@dataclass(frozen=True)
class Chamber(Stage):
    pressure: Expression
    flow: Expression = 0

@dataclass(frozen=True)
class Piston(Stage):
    speed: Expression
    force: Expression = 0

@physics("cylinder", summary="A valve moves a piston against a spring.", source="Merritt, Hydraulic Control Systems",
    parameters=(constant("mass", "kg", 20.0, lower=0.1), constant("spring", "N/m", 2e4, lower=1.0),
                constant("bulk", "Pa/m^3", 1e10, lower=1e6), constant("valve", "m^3/s", 1e-4, lower=1e-8)),
    states=(state("place", "m", typical=0.02), state("speed", "m/s", typical=0.1),
            state("pressure", "Pa", typical=2e5)),
    inputs={"extra.valve": "1"}, outputs={"q.piston": "m", "extra.pressure": "Pa"}, period=0.3)
def cylinder(at: Moment) -> Equations:
    x, v, p = at["place"], at["speed"], at["pressure"]
    valve = at.stage("valve", Valve(at.input("extra.valve").value))
    chamber, piston = at.stage("chamber", Chamber(p)), at.stage("piston", Piston(v))
    return Equations(
        {"place": v, "speed": (AREA * p - at["spring"] * x + piston.force) / at["mass"],
         "pressure": at["bulk"] * (at["valve"] * valve.opening - AREA * v + chamber.flow)},
        {"q.piston": x, "extra.pressure": p})

@effect(summary="the valve opens late", source="Merritt")
def valve_dead_zone(valve: Valve, width: Expression = quantity("1", typical=0.05, lower=0.0)) -> Valve:
    return replace(valve, opening=valve.opening - ca.fmax(ca.fmin(valve.opening, width), -width))

@effect(summary="oil leaks past the piston", source="Merritt")
def inner_leak(chamber: Chamber, size: Expression = quantity("m^3/(Pa s)", typical=1e-11, lower=0.0)) -> Chamber:
    return replace(chamber, flow=chamber.flow - size * chamber.pressure)

@effect(summary="friction of the seal", source="of its own")
def seal(piston: Piston, size: Expression = quantity("N s/m", typical=100.0, lower=0.0)) -> Piston:
    return replace(piston, force=piston.force - size * piston.speed)
''',
    {"mass": 20.0, "spring": 2e4, "bulk": 1e10, "valve": 1e-4},
    {"valve_dead_zone": {"width": 0.08}, "inner_leak": {"size": 2e-11}, "seal": {"size": 150.0}}, _hydraulic,
    {"q.piston": 0, "extra.pressure": 2},
    {"q.piston": 1e-4, "extra.pressure": 2e3}, (0.0, 0.6), 6.0, (0.01, 0.02, 2e5), 6.0, 400.0, "extra.valve", "1",
)  # fmt: skip

FAST = (FILTER, MOTOR, GEARED, MASSES, CART, DOUBLE, TRAIN, CYLINDER)
