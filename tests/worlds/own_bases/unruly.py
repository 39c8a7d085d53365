"""Bases that are unstable, stiff, in contact, or remember; some are felt by accelerometers only."""

import numpy as np

from worlds.own_bases import Case, Family

G = 9.81


def _magnet(c: Case, s: np.ndarray, u: float) -> list[float]:
    gap, v = s
    pull = c["force"] * max(u + c["remanence.current"], 0.0) ** 2 / max(gap, 1e-4) ** 2
    return [v, G - (pull + c["eddies.size"] * v + c["guide.friction"] * np.tanh(v / 0.002)) / 0.08]


def _held_up(c: Case, s: np.ndarray, aim: float) -> float:
    rest = np.sqrt(0.08 * G / c["force"]) * aim
    return float(np.clip(rest + 2.0 * rest / aim * (s[0] - aim) + 0.03 * rest / aim * s[1], 0.0, 6.0))


MAGLEV = Family(
    "maglev", "unstable", '''
@dataclass(frozen=True)
class Ball(Stage):
    speed: Expression
    force: Expression = 0

@dataclass(frozen=True)
class Coil(Stage):
    current: Expression

@physics("maglev", summary="A steel ball below an electromagnet.", source="Woodson & Melcher 1968",
    parameters=(constant("force", "N m^2/A^2", 1e-4, lower=1e-7),),
    states=(state("gap", "m", typical=0.01, start=0.012, lower=1e-4), state("speed", "m/s", typical=0.1)),
    inputs={"extra.current": "A"}, outputs={"extra.gap": "m"}, held=("extra.current",), period=0.2)
def maglev(at: Moment) -> Equations:
    ball = at.stage("ball", Ball(at["speed"]))
    current = at.stage("coil", Coil(at.input("extra.current").value)).current
    pull = at["force"] * ca.fmax(current, 0) ** 2 / ca.fmax(at["gap"], 1e-4) ** 2
    return Equations({"gap": at["speed"], "speed": 9.81 + (ball.force - pull) / 0.08}, {"extra.gap": at["gap"]})

@effect(summary="eddy currents brake", source="Lenz 1834")
def eddies(ball: Ball, size: Expression = quantity("N s/m", typical=0.5, lower=0.0)) -> Ball:
    return replace(ball, force=ball.force - size * ball.speed)

@effect(summary="the core stays magnetic", source="Ewing 1881")
def remanence(coil: Coil, current: Expression = quantity("A", typical=0.1)) -> Coil:
    return replace(coil, current=coil.current + current)

@effect(summary="a guide rubs", source="Coulomb 1785")
def guide(ball: Ball, friction: Expression = quantity("N", typical=0.05, lower=0.0)) -> Ball:
    return replace(ball, force=ball.force - friction * ca.tanh(ball.speed / 0.002))
''',
    {"force": 1.1e-4},
    {"eddies": {"size": 1.5}, "remanence": {"current": 0.15}, "guide": {"friction": 0.06}}, _magnet,
    {"extra.gap": 0}, {"extra.gap": 5e-5}, (0.012, 0.003), 9.0, (0.012, 0.01), 3.0, 500.0, "extra.current", "A",
    held=True, control=_held_up,
)  # fmt: skip


def _flies(c: Case, s: np.ndarray, u: float) -> list[float]:
    height, v, thrust = s
    near = 1.0 + c["ground_effect.size"] * np.exp(-max(height, 0.0) / 0.4)
    return [v, (near * thrust - c["drag.size"] * v * abs(v)) / 0.7 - G,
            (u * c["motor"] - thrust) / c["lag"]]  # fmt: skip


def _felt_climb(c: Case, y: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.array([_flies(c, s, 0.0)[1] + G for s in y.T])


def _hover(c: Case, s: np.ndarray, aim: float) -> float:
    want = 0.7 * (G + 4.0 * (aim - s[0]) - 3.0 * s[1])
    return float(np.clip(want / c["motor"], 0.0, 1.0))


ALTITUDE = Family(
    "altitude", "unstable", '''
@dataclass(frozen=True)
class Air(Stage):
    speed: Expression
    height: Expression
    thrust: Expression
    force: Expression = 0

@physics("altitude", summary="A multicopter that climbs and sinks.", source="Mahony et al. 2012",
    parameters=(constant("motor", "N", 14.0, lower=0.5),
                constant("lag", "s", 0.06, lower=1e-3)),
    states=(state("height", "m", typical=1.0), state("climb", "m/s", typical=1.0),
            state("thrust", "N", typical=5.0, start=7.0)),
    inputs={"extra.throttle": "1"}, outputs={"extra.height": "m", "extra.felt": "m/s^2"}, held=("extra.throttle",),
    period=1.5)
def altitude(at: Moment) -> Equations:
    air = at.stage("air", Air(at["climb"], at["height"], at["thrust"]))
    felt = (air.thrust + air.force) / 0.7
    return Equations(
        {"height": at["climb"], "climb": felt - 9.81,
         "thrust": (at["motor"] * at.input("extra.throttle").value - at["thrust"]) / at["lag"]},
        {"extra.height": at["height"], "extra.felt": felt})

@effect(summary="air drag", source="Rayleigh 1876")
def drag(air: Air, size: Expression = quantity("N s^2/m^2", typical=0.1, lower=0.0)) -> Air:
    return replace(air, force=air.force - size * air.speed * ca.fabs(air.speed))

@effect(summary="air below the rotors near the ground", source="Cheeseman & Bennett 1955")
def ground_effect(air: Air, size: Expression = quantity("1", typical=0.1, lower=0.0)) -> Air:
    return replace(air, thrust=air.thrust * (1 + size * ca.exp(-ca.fmax(air.height, 0) / 0.4)))
''',
    {"motor": 15.0, "lag": 0.07}, {"drag": {"size": 0.6}, "ground_effect": {"size": 0.15}}, _flies,
    {"extra.height": 0, "extra.felt": _felt_climb},
    {"extra.height": 0.01, "extra.felt": 0.1}, (1.0, 0.8), 1.2, (1.0, 0.3, 7.0), 20.0, 100.0, "extra.throttle", "1",
    held=True, control=_hover,
)  # fmt: skip


def _rolls(c: Case, s: np.ndarray, u: float) -> list[float]:
    _, v = s
    lost = c["rolling.friction"] * np.tanh(v / 0.005) + c["air.size"] * v
    return [v, c["share"] * G * np.sin(u + c["tilted.angle"]) - lost]


def _balance(_: Case, s: np.ndarray, aim: float) -> float:
    return float(np.clip(0.5 * (aim - s[0]) - 0.35 * s[1], -0.3, 0.3))


BEAM = Family(
    "beam", "unstable", '''
@dataclass(frozen=True)
class Ball(Stage):
    speed: Expression
    acceleration: Expression = 0

@dataclass(frozen=True)
class Slope(Stage):
    angle: Expression

@physics("beam", summary="A ball rolls on a beam that a motor tilts.", source="Wellstead 1979",
    parameters=(constant("share", "1", 0.7, lower=0.05, upper=1.0),),
    states=(state("place", "m", typical=0.1), state("speed", "m/s", typical=0.1)),
    inputs={"q.beam": "rad"}, outputs={"extra.place": "m"}, period=1.5)
def beam(at: Moment) -> Equations:
    ball, slope = at.stage("ball", Ball(at["speed"])), at.stage("slope", Slope(at.input("q.beam").value))
    return Equations({"place": at["speed"], "speed": at["share"] * 9.81 * ca.sin(slope.angle) + ball.acceleration},
                     {"extra.place": at["place"]})

@effect(summary="rolling friction", source="Coulomb 1785")
def rolling(ball: Ball, friction: Expression = quantity("m/s^2", typical=0.05, lower=0.0)) -> Ball:
    return replace(ball, acceleration=ball.acceleration - friction * ca.tanh(ball.speed / 0.005))

@effect(summary="viscous loss", source="of its own")
def air(ball: Ball, size: Expression = quantity("1/s", typical=0.1, lower=0.0)) -> Ball:
    return replace(ball, acceleration=ball.acceleration - size * ball.speed)

@effect(summary="the table is not level", source="of its own")
def tilted(slope: Slope, angle: Expression = quantity("rad", typical=0.02)) -> Slope:
    return replace(slope, angle=slope.angle + angle)
''',
    {"share": 0.7}, {"rolling": {"friction": 0.06}, "air": {"size": 0.5}, "tilted": {"angle": 0.02}}, _rolls,
    {"extra.place": 0}, {"extra.place": 0.003}, (0.0, 0.2), 0.8, (0.1, 0.05), 25.0, 50.0, "q.beam", "rad",
    held=True, control=_balance,
)  # fmt: skip


def _hops(c: Case, s: np.ndarray, u: float) -> list[float]:
    x, v = s
    pressed = max(-x, 0.0)
    ground = c["pad"] * pressed + (30.0 * v * (-1.0) if pressed else 0.0) * 1.0
    return [
        v,
        u / c["mass"] - G + (max(ground, 0.0) - c["slide.drag"] * v) / c["mass"] - c["string.pull"] * x / c["mass"],
    ]


HOPPER = Family(
    "hopper", "contact", '''
@dataclass(frozen=True)
class Body(Stage):
    height: Expression
    speed: Expression
    force: Expression = 0

@physics("hopper", summary="A voice coil lifts a mass off a pad and drops it.", source="Raibert 1986",
    parameters=(constant("mass", "kg", 0.5, lower=0.01), constant("pad", "N/m", 3000.0, lower=10.0)),
    states=(state("height", "m", typical=0.02), state("speed", "m/s", typical=0.3)),
    inputs={"extra.force": "N"}, outputs={"extra.height": "m"}, period=0.3, step=0.002)
def hopper(at: Moment) -> Equations:
    x, v = at["height"], at["speed"]
    pressed = ca.fmax(-x, 0)
    pad = ca.fmax(at["pad"] * pressed - ca.if_else(x < 0, 30.0 * v, 0), 0)
    body = at.stage("body", Body(x, v))
    return Equations({"height": v, "speed": (at.input("extra.force").value + pad + body.force) / at["mass"] - 9.81},
                     {"extra.height": x})

@effect(summary="a viscous slide", source="of its own")
def slide(body: Body, drag: Expression = quantity("N s/m", typical=0.5, lower=0.0)) -> Body:
    return replace(body, force=body.force - drag * body.speed)

@effect(summary="a rubber string pulls down", source="Hooke 1678")
def string(body: Body, pull: Expression = quantity("N/m", typical=20.0, lower=0.0)) -> Body:
    return replace(body, force=body.force - pull * body.height)
''',
    {"mass": 0.5, "pad": 4000.0}, {"slide": {"drag": 0.8}, "string": {"pull": 25.0}}, _hops,
    {"extra.height": 0}, {"extra.height": 1e-4}, (4.3, 3.0), 12.0, (0.01, 0.05), 4.0, 500.0, "extra.force", "N",
)  # fmt: skip


def _slips(c: Case, s: np.ndarray, u: float) -> list[float]:
    x, v = s
    rub = c["dry.force"] * np.tanh((v - 0.0) / 0.001) + c["oil.size"] * v
    stiffening = c["stiffening.size"] * x**3
    return [v, c["spring"] * (u - x) - stiffening - rub - 0.2 * v]


SLIDER = Family(
    "slider", "dry friction", '''
@dataclass(frozen=True)
class Block(Stage):
    place: Expression
    speed: Expression
    force: Expression = 0

@physics("slider", summary="A block is pulled over a table by a spring.", source="Heslot et al. 1994",
    parameters=(constant("spring", "N/m", 120.0, lower=1.0),),
    states=(state("place", "m", typical=0.1), state("speed", "m/s", typical=0.2)),
    inputs={"extra.hand": "m"}, outputs={"extra.place": "m"}, period=0.6)
def slider(at: Moment) -> Equations:
    block = at.stage("block", Block(at["place"], at["speed"]))
    pull = at["spring"] * (at.input("extra.hand").value - at["place"])
    return Equations({"place": at["speed"], "speed": pull + block.force - 0.2 * at["speed"]},
                     {"extra.place": at["place"]})

@effect(summary="dry friction", source="Coulomb 1785")
def dry(block: Block, force: Expression = quantity("N", typical=1.0, lower=0.0)) -> Block:
    return replace(block, force=block.force - force * ca.tanh(block.speed / 0.001))

@effect(summary="oil", source="Newton 1687")
def oil(block: Block, size: Expression = quantity("N s/m", typical=1.0, lower=0.0)) -> Block:
    return replace(block, force=block.force - size * block.speed)

@effect(summary="a second spring that stiffens", source="Duffing 1918")
def stiffening(block: Block, size: Expression = quantity("N/m^3", typical=500.0, lower=0.0)) -> Block:
    return replace(block, force=block.force - size * block.place ** 3)
''',
    {"spring": 120.0}, {"dry": {"force": 2.0}, "oil": {"size": 1.5}, "stiffening": {"size": 800.0}},
    _slips, {"extra.place": 0}, {"extra.place": 3e-4}, (0.0, 0.15), 4.0, (0.05, 0.1), 10.0, 200.0, "extra.hand", "m",
)  # fmt: skip


def _remembers(c: Case, s: np.ndarray, u: float) -> list[float]:
    x, v, z = s
    A = 1.0
    return [v, (u - c["stiffness"] * x - c["rubber.force"] * z - c["damper.size"] * v - 1.0 * v) / c["mass"],
            (A * v - abs(v) * abs(z) * z * 1.0) / 0.01]  # fmt: skip


MOUNT = Family(
    "mount", "memory", '''
@dataclass(frozen=True)
class Rubber(Stage):
    strain: Expression
    speed: Expression
    force: Expression = 0

@physics("mount", summary="A machine on a rubber mount.", source="Bouc 1967, Wen 1976",
    parameters=(constant("mass", "kg", 2.0, lower=0.1), constant("stiffness", "N/m", 800.0, lower=10.0)),
    states=(state("place", "m", typical=0.02), state("speed", "m/s", typical=0.3),
            state("strain", "1", typical=0.5)),
    inputs={"extra.force": "N"}, outputs={"extra.place": "m"}, period=0.3, step=0.002)
def mount(at: Moment) -> Equations:
    x, v, z = at["place"], at["speed"], at["strain"]
    rubber = at.stage("rubber", Rubber(z, v))
    return Equations(
        {"place": v, "speed": (at.input("extra.force").value - at["stiffness"] * x - v + rubber.force) / at["mass"],
         "strain": (v - ca.fabs(v) * ca.fabs(z) * z) / 0.01},
        {"extra.place": x})

@effect(summary="the rubber remembers", source="Bouc 1967")
def rubber(rubber: Rubber, force: Expression = quantity("N", typical=2.0, lower=0.0)) -> Rubber:
    return replace(rubber, force=rubber.force - force * rubber.strain)

@effect(summary="a viscous damper", source="of its own")
def damper(rubber: Rubber, size: Expression = quantity("N s/m", typical=5.0, lower=0.0)) -> Rubber:
    return replace(rubber, force=rubber.force - size * rubber.speed)
''',
    {"mass": 2.0, "stiffness": 900.0}, {"rubber": {"force": 4.0}, "damper": {"size": 6.0}}, _remembers,
    {"extra.place": 0}, {"extra.place": 1e-4}, (0.0, 25.0), 12.0, (0.01, 0.1, 0.1), 5.0, 400.0, "extra.force", "N",
)  # fmt: skip


def _swings(c: Case, s: np.ndarray, _: float) -> list[float]:
    q, w = s
    lost = c["bearing.size"] * w + c["wind_drag.size"] * w * abs(w) + c["dry_bearing.torque"] * np.tanh(w / 0.02)
    return [w, -G / c["length"] * np.sin(q) - lost]


def _along(c: Case, y: np.ndarray, _: np.ndarray) -> np.ndarray:
    return c["length"] * y[1] ** 2 + G * np.cos(y[0])


def _across(c: Case, y: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.array([c["length"] * _swings(c, s, 0.0)[1] + G * np.sin(s[0]) for s in y.T])


FELT = Family(
    "felt", "accelerometer", '''
@dataclass(frozen=True)
class Hinge(Stage):
    rate: Expression
    acceleration: Expression = 0

@physics("felt", summary="A rod swings with an accelerometer and a gyro at its end.", source="Huygens 1673",
    parameters=(constant("length", "m", 0.8, lower=0.05),),
    states=(state("angle", "rad", typical=0.5), state("rate", "rad/s", typical=1.0)),
    inputs={}, outputs={"extra.gyro": "rad/s", "extra.along": "m/s^2", "extra.across": "m/s^2"}, period=1.7)
def felt(at: Moment) -> Equations:
    q, w, L = at["angle"], at["rate"], at["length"]
    hinge = at.stage("hinge", Hinge(w))
    turning = -9.81 / L * ca.sin(q) + hinge.acceleration
    return Equations({"angle": w, "rate": turning},
                     {"extra.gyro": w, "extra.along": L * w ** 2 + 9.81 * ca.cos(q),
                      "extra.across": L * turning + 9.81 * ca.sin(q)})

@effect(summary="viscous bearing", source="of its own")
def bearing(hinge: Hinge, size: Expression = quantity("1/s", typical=0.05, lower=0.0)) -> Hinge:
    return replace(hinge, acceleration=hinge.acceleration - size * hinge.rate)

@effect(summary="air", source="Rayleigh 1876")
def wind_drag(hinge: Hinge, size: Expression = quantity("1/rad", typical=0.02, lower=0.0)) -> Hinge:
    return replace(hinge, acceleration=hinge.acceleration - size * hinge.rate * ca.fabs(hinge.rate))

@effect(summary="dry friction", source="Coulomb 1785")
def dry_bearing(hinge: Hinge, torque: Expression = quantity("rad/s^2", typical=0.1, lower=0.0)) -> Hinge:
    return replace(hinge, acceleration=hinge.acceleration - torque * ca.tanh(hinge.rate / 0.02))
''',
    {"length": 0.7}, {"bearing": {"size": 0.06}, "wind_drag": {"size": 0.03}, "dry_bearing": {"torque": 0.15}},
    _swings, {"extra.gyro": 1, "extra.along": _along, "extra.across": _across},
    {"extra.gyro": 0.02, "extra.along": 0.1, "extra.across": 0.1}, (0.0, 0.0), 1.0, (0.9, 0.5), 25.0, 100.0, "", "",
)  # fmt: skip


def _flash(c: Case, s: np.ndarray, u: float) -> list[float]:
    fast, slow = s
    leak = c["bleeder.conductance"] * slow
    diode = c["clamp.conductance"] * max(fast - 6.0, 0.0)
    between = (fast - slow) / c["series"]
    return [((u - fast) / c["source"] - between - diode) / 1e-6, (between - leak) / c["store"]]


STIFF = Family(
    "charger", "stiff", '''
@dataclass(frozen=True)
class Store(Stage):
    voltage: Expression
    current: Expression = 0

@dataclass(frozen=True)
class Input(Stage):
    voltage: Expression
    current: Expression = 0

@physics("charger", summary="A small and a large capacitor, 2000 times slower.", source="Kirchhoff 1845",
    parameters=(constant("source", "ohm", 50.0, lower=1.0), constant("series", "ohm", 500.0, lower=1.0),
                constant("store", "F", 2e-3, lower=1e-5)),
    states=(state("fast", "V", typical=5.0), state("slow", "V", typical=5.0)),
    inputs={"extra.supply": "V"}, outputs={"extra.fast": "V", "extra.slow": "V"}, held=("extra.supply",), period=2.0)
def charger(at: Moment) -> Equations:
    between = (at["fast"] - at["slow"]) / at["series"]
    store, inlet = at.stage("store", Store(at["slow"])), at.stage("inlet", Input(at["fast"]))
    supplied = (at.input("extra.supply").value - at["fast"]) / at["source"]
    return Equations({"fast": (supplied - between + inlet.current) / 1e-6,
                      "slow": (between + store.current) / at["store"]},
                     {"extra.fast": at["fast"], "extra.slow": at["slow"]})

@effect(summary="a bleeder", source="Ohm 1827")
def bleeder(store: Store, conductance: Expression = quantity("1/ohm", typical=1e-4, lower=0.0)) -> Store:
    return replace(store, current=store.current - conductance * store.voltage)

@effect(summary="a clamp above 6 V", source="Zener 1934")
def clamp(inlet: Input, conductance: Expression = quantity("1/ohm", typical=1e-3, lower=0.0)) -> Input:
    return replace(inlet, current=inlet.current - conductance * ca.fmax(inlet.voltage - 6, 0))
''',
    {"source": 60.0, "series": 450.0, "store": 1.8e-3},
    {"bleeder": {"conductance": 4e-4}, "clamp": {"conductance": 2e-3}}, _flash, {"extra.fast": 0, "extra.slow": 1},
    {"extra.fast": 0.02, "extra.slow": 0.02}, (5.0, 5.0), 1.0, (3.0, 3.0), 20.0, 50.0, "extra.supply", "V", held=True,
)  # fmt: skip

UNRULY = (MAGLEV, ALTITUDE, BEAM, HOPPER, SLIDER, MOUNT, FELT, STIFF)
