"""Bases whose states are temperatures, levels, pressures, charges: of first order, slow, in their own units."""

import numpy as np

from . import Case, Family


def _oven(c: Case, s: np.ndarray, u: float) -> list[float]:
    (T,) = s
    power, warmer = min(u, c["heater_limit.most"] or np.inf), T - 293.0
    loss = warmer / c["resistance"] + c["radiation.size"] * (T**4 - 293.0**4) + c["draught.size"] * warmer * abs(warmer)
    return [(power - loss) / c["capacity"]]


OVEN = Family(
    "oven", "thermal", '''
AMBIENT = 293.0

@dataclass(frozen=True)
class Wall(Stage):
    temperature: Expression
    heat: Expression = 0

@dataclass(frozen=True)
class Heater(Stage):
    power: Expression

@physics("oven", summary="An oven that loses heat.", source="Newton 1701",
    parameters=(constant("capacity", "J/K", 500.0, lower=1.0), constant("resistance", "K/W", 0.5, lower=0.01)),
    states=(state("temperature", "K", typical=50.0, start=320.0),),
    inputs={"extra.power": "W"}, outputs={"extra.temperature": "K"}, period=400.0)
def oven(at: Moment) -> Equations:
    T = at["temperature"]
    heater = at.stage("heater", Heater(at.input("extra.power").value))
    wall = at.stage("wall", Wall(T, -(T - AMBIENT) / at["resistance"]))
    return Equations({"temperature": (heater.power + wall.heat) / at["capacity"]}, {"extra.temperature": T})

@effect(summary="radiation", source="Stefan 1879")
def radiation(wall: Wall, size: Expression = quantity("W/K^4", typical=1e-8, lower=0.0)) -> Wall:
    return replace(wall, heat=wall.heat - size * (wall.temperature**4 - AMBIENT**4))

@effect(summary="free convection", source="of its own")
def draught(wall: Wall, size: Expression = quantity("W/K^2", typical=0.01, lower=0.0)) -> Wall:
    warmer = wall.temperature - AMBIENT
    return replace(wall, heat=wall.heat - size * warmer * ca.fabs(warmer))

@effect(summary="a constant heat from elsewhere", source="of its own")
def neighbour(wall: Wall, heat: Expression = quantity("W", typical=10.0)) -> Wall:
    return replace(wall, heat=wall.heat + heat)
''',
    {"capacity": 400.0, "resistance": 0.6}, {"radiation": {"size": 2.5e-8}, "draught": {"size": 0.015}}, _oven,
    {"extra.temperature": 0}, {"extra.temperature": 0.3}, (250.0, 180.0), 0.02, (330.0,), 2400.0,
    0.5, "extra.power", "W",
)  # fmt: skip


def _room(c: Case, s: np.ndarray, u: float) -> list[float]:
    element, air = s
    across = (element - air) / c["coupling"] + c["radiated.size"] * (element**4 - air**4)
    loss = (air - 283.0) / c["insulation"] + c["leak.size"] * (air - 283.0) * abs(air - 283.0)
    return [(u - across) / c["element"], (across - loss) / c["air"]]


ROOM = Family(
    "room", "thermal", '''
OUTSIDE = 283.0

@dataclass(frozen=True)
class Air(Stage):
    temperature: Expression
    heat: Expression

@dataclass(frozen=True)
class Surface(Stage):
    element: Expression
    air: Expression
    heat: Expression

@physics("room", summary="A heating element warms a room.", source="Incropera, Fundamentals of Heat Transfer",
    parameters=(
        constant("element", "J/K", 1000.0, lower=1.0), constant("air", "J/K", 5000.0, lower=1.0),
        constant("coupling", "K/W", 0.1, lower=1e-3), constant("insulation", "K/W", 0.2, lower=1e-3)),
    states=(state("element_temperature", "K", typical=30.0, start=300.0),
            state("air_temperature", "K", typical=10.0, start=290.0)),
    inputs={"extra.heating": "W"}, outputs={"extra.air": "K"}, held=("extra.heating",), period=600.0)
def room(at: Moment) -> Equations:
    hot, air = at["element_temperature"], at["air_temperature"]
    across = at.stage("surface", Surface(hot, air, (hot - air) / at["coupling"])).heat
    inside = at.stage("air", Air(air, across - (air - OUTSIDE) / at["insulation"]))
    return Equations(
        {"element_temperature": (at.input("extra.heating").value - across) / at["element"],
         "air_temperature": inside.heat / at["air"]},
        {"extra.air": air})

@effect(summary="air that leaks with the square", source="of its own")
def leak(air: Air, size: Expression = quantity("W/K^2", typical=1.0, lower=0.0)) -> Air:
    warmer = air.temperature - OUTSIDE
    return replace(air, heat=air.heat - size * warmer * ca.fabs(warmer))

@effect(summary="radiation of the element", source="Stefan 1879")
def radiated(surface: Surface, size: Expression = quantity("W/K^4", typical=1e-7, lower=0.0)) -> Surface:
    return replace(surface, heat=surface.heat + size * (surface.element**4 - surface.air**4))

@effect(summary="a person", source="of its own")
def person(air: Air, heat: Expression = quantity("W", typical=50.0)) -> Air:
    return replace(air, heat=air.heat + heat)
''',
    {"element": 900.0, "air": 4500.0, "coupling": 0.12, "insulation": 0.18},
    {"leak": {"size": 0.8}, "radiated": {"size": 1.5e-7}}, _room,
    {"extra.air": 1}, {"extra.air": 0.05}, (150.0, 130.0), 0.008, (300.0, 296.0), 4800.0, 0.2,
    "extra.heating", "W", held=True,
)  # fmt: skip


def _tanks(c: Case, s: np.ndarray, u: float) -> list[float]:
    upper, lower = np.maximum(s, 0.0)
    pumped = max(u - c["pump_dead_zone.width"], 0.0)
    out1, out2 = c["first_hole"] * np.sqrt(upper), c["second_hole"] * np.sqrt(lower)
    over = c["overflow.slope"] * max(upper - c["overflow.edge"], 0.0)
    return [c["pump"] * pumped - out1 - over, out1 - out2 - c["seepage.size"] * lower]


TANKS = Family(
    "tanks", "hydraulic", '''
@dataclass(frozen=True)
class Upper(Stage):
    level: Expression
    flow: Expression = 0

@dataclass(frozen=True)
class Lower(Stage):
    level: Expression
    flow: Expression = 0

@dataclass(frozen=True)
class Pump(Stage):
    voltage: Expression

@physics("tanks", summary="Two tanks, one below the other.", source="Torricelli 1643",
    parameters=(constant("pump", "1/s", 0.05, lower=1e-3), constant("first_hole", "V^0.5/s", 0.07, lower=1e-3),
                constant("second_hole", "V^0.5/s", 0.07, lower=1e-3)),
    states=(state("upper", "V", typical=5.0, start=4.0, lower=0.0, upper=20.0),
            state("lower", "V", typical=5.0, start=4.0, lower=0.0, upper=20.0)),
    inputs={"extra.pump": "V"}, outputs={"extra.level": "V"}, period=150.0)
def tanks(at: Moment) -> Equations:
    first = at["first_hole"] * ca.sqrt(ca.fmax(at["upper"], 1e-4))
    second = at["second_hole"] * ca.sqrt(ca.fmax(at["lower"], 1e-4))
    pump = at.stage("pump", Pump(at.input("extra.pump").value))
    upper, lower = at.stage("upper", Upper(at["upper"])), at.stage("lower", Lower(at["lower"]))
    return Equations(
        {"upper": at["pump"] * pump.voltage - first + upper.flow, "lower": first - second + lower.flow},
        {"extra.level": at["lower"]})

@effect(summary="water seeps from the lower tank", source="of its own")
def seepage(lower: Lower, size: Expression = quantity("1/s", typical=0.005, lower=0.0)) -> Lower:
    return replace(lower, flow=lower.flow - size * lower.level)

@effect(summary="the upper tank overflows", source="of its own")
def overflow(upper: Upper, slope: Expression = quantity("1/s", typical=0.1, lower=0.0),
             edge: Expression = quantity("V", typical=1.0, null=8.0, lower=0.0)) -> Upper:
    return replace(upper, flow=upper.flow - slope * ca.fmax(upper.level - edge, 0))

@effect(summary="the pump begins to pump at a voltage", source="of its own")
def pump_dead_zone(pump: Pump, width: Expression = quantity("V", typical=0.5, lower=0.0)) -> Pump:
    return replace(pump, voltage=pump.voltage - ca.fmin(pump.voltage, width))
''',
    {"pump": 0.055, "first_hole": 0.075, "second_hole": 0.08},
    {"seepage": {"size": 0.006}, "overflow": {"slope": 0.15, "edge": 7.0}, "pump_dead_zone": {"width": 0.8}}, _tanks,
    {"extra.level": 1}, {"extra.level": 0.03}, (3.2, 2.6), 0.025, (6.0, 5.0), 2400.0, 0.5,
    "extra.pump", "V",
)  # fmt: skip


def _vessel(c: Case, s: np.ndarray, u: float) -> list[float]:
    (p,) = s
    lost = c["leakage.size"] * p + c["relief_valve.slope"] * max(p - c["relief_valve.opens"], 0.0)
    return [c["supply"] * (u - p) - c["outlet"] * np.sqrt(max(p, 0.0)) - lost]


VESSEL = Family(
    "vessel", "pneumatic", '''
@dataclass(frozen=True)
class Chamber(Stage):
    pressure: Expression
    flow: Expression = 0

@physics("vessel", summary="A pressure vessel with a hole.", source="Bernoulli 1738",
    parameters=(constant("supply", "1/s", 0.5, lower=1e-3), constant("outlet", "Pa^0.5/s", 100.0, lower=0.1)),
    states=(state("pressure", "Pa", typical=1e5, start=1e5, lower=0.0),),
    inputs={"extra.supply": "Pa"}, outputs={"extra.pressure": "Pa"}, period=10.0)
def vessel(at: Moment) -> Equations:
    p = at["pressure"]
    chamber = at.stage("chamber", Chamber(p))
    rate = at["supply"] * (at.input("extra.supply").value - p) - at["outlet"] * ca.sqrt(ca.fmax(p, 1.0))
    return Equations({"pressure": rate + chamber.flow}, {"extra.pressure": p})

@effect(summary="a leak in proportion", source="Poiseuille 1840")
def leakage(chamber: Chamber, size: Expression = quantity("1/s", typical=0.1, lower=0.0)) -> Chamber:
    return replace(chamber, flow=chamber.flow - size * chamber.pressure)

@effect(summary="a valve that opens at a pressure", source="of its own")
def relief_valve(chamber: Chamber, slope: Expression = quantity("1/s", typical=1.0, lower=0.0),
                 opens: Expression = quantity("Pa", typical=1e4, null=2e5, lower=0.0)) -> Chamber:
    return replace(chamber, flow=chamber.flow - slope * ca.fmax(chamber.pressure - opens, 0))
''',
    {"supply": 0.6, "outlet": 110.0}, {"leakage": {"size": 0.12}, "relief_valve": {"slope": 2.0, "opens": 1.9e5}},
    _vessel, {"extra.pressure": 0}, {"extra.pressure": 500.0}, (2.8e5, 1.2e5), 0.8, (1.8e5,), 60.0,
    10.0, "extra.supply", "Pa",
)  # fmt: skip


def _battery(c: Case, s: np.ndarray, u: float) -> list[float]:
    charge, relaxation = s
    return [-u - c["self_discharge.size"] * charge, u / c["double_layer"] - relaxation / c["relaxing"]]


def _battery_voltage(c: Case, y: np.ndarray, u: np.ndarray) -> np.ndarray:
    drop = c["resistance"] * u + c["warming.size"] * u * abs(u)
    return c["open_circuit"] + 1e-4 * y[0] - y[1] - drop


BATTERY = Family(
    "battery", "electrical", '''
@dataclass(frozen=True)
class Terminal(Stage):
    current: Expression
    drop: Expression

@dataclass(frozen=True)
class Cell(Stage):
    charge: Expression
    current: Expression

@physics("battery", summary="A cell with one relaxation.", source="Plett, Battery Management Systems, vol. 1",
    parameters=(constant("open_circuit", "V", 3.0, lower=1.0, upper=5.0),
                constant("resistance", "ohm", 0.02, lower=1e-4),
                constant("double_layer", "F", 2000.0, lower=10.0), constant("relaxing", "s", 60.0, lower=1.0)),
    states=(state("charge", "C", typical=5000.0, start=9000.0), state("relaxation", "V", typical=0.05)),
    inputs={"extra.current": "A"}, outputs={"extra.voltage": "V"}, held=("extra.current",), period=200.0)
def battery(at: Moment) -> Equations:
    i = at.input("extra.current").value
    cell = at.stage("cell", Cell(at["charge"], -i))
    drop = at.stage("terminal", Terminal(i, at["resistance"] * i)).drop
    return Equations(
        {"charge": cell.current, "relaxation": i / at["double_layer"] - at["relaxation"] / at["relaxing"]},
        {"extra.voltage": at["open_circuit"] + 1e-4 * at["charge"] - at["relaxation"] - drop})

@effect(summary="the resistance grows with the current", source="Butler & Volmer")
def warming(terminal: Terminal, size: Expression = quantity("ohm/A", typical=1e-3, lower=0.0)) -> Terminal:
    return replace(terminal, drop=terminal.drop + size * terminal.current * ca.fabs(terminal.current))

@effect(summary="self discharge", source="of its own")
def self_discharge(cell: Cell, size: Expression = quantity("1/s", typical=1e-4, lower=0.0)) -> Cell:
    return replace(cell, current=cell.current - size * cell.charge)
''',
    {"open_circuit": 3.0, "resistance": 0.025, "double_layer": 1800.0, "relaxing": 70.0},
    {"warming": {"size": 2e-3}, "self_discharge": {"size": 1e-4}}, _battery, {"extra.voltage": _battery_voltage},
    {"extra.voltage": 1e-3}, (1.5, 4.0), 0.05, (9000.0, 0.02), 2400.0, 0.5, "extra.current", "A", held=True,
)  # fmt: skip

SLOW = (OVEN, ROOM, TANKS, VESSEL, BATTERY)
