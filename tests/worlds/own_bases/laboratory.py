"""Bases in the units of a laboratory: a heated rod of fifth order in degC, and a stirred reactor in mol/l and degC."""

import numpy as np

from worlds.own_bases import Case, Family

AIR, CELLS = 22.0, 5


def _rod(c: Case, s: np.ndarray, u: float) -> list[float]:
    flow = c["conduction"] * np.diff(s)
    rates = -c["cooling"] * (s - AIR) + np.append(flow, 0.0) - np.insert(flow, 0, 0.0)
    rates[0] += c["heating"] * min(u, c["heater_limit.limit"] or np.inf)
    rates[0] -= c["radiation.size"] * (((s[0] + 273.15) / 293.15) ** 4 - ((AIR + 273.15) / 293.15) ** 4)
    rates[-1] -= c["contact.size"] * (s[-1] - AIR)
    return list(rates)


ROD = Family(
    "rod", "thermal", '''
AIR, CELLS = 22.0, 5

@dataclass(frozen=True)
class Heater(Stage):
    power: Expression

@physics("rod", summary="A rod that is heated at one end.", source="Fourier 1822",
    parameters=(constant("conduction", "1/s", 0.03, lower=1e-4), constant("cooling", "1/s", 2e-3, lower=1e-6),
                constant("heating", "K/s/W", 0.03, lower=1e-4)),
    states=tuple(state(f"T{i}", "degC", typical=20.0, start=35.0) for i in range(CELLS)),
    inputs={"extra.power": "W"}, outputs={"extra.first": "degC", "extra.last": "degC"}, held=("extra.power",),
    period=300.0)
def rod(at: Moment) -> Equations:
    T = [at[f"T{i}"] for i in range(CELLS)]
    rates = {}
    for i in range(CELLS):
        beside = [T[j] - T[i] for j in (i - 1, i + 1) if 0 <= j < CELLS]
        rates[f"T{i}"] = at["conduction"] * sum(beside) - at["cooling"] * (T[i] - AIR)
    rates["T0"] += at["heating"] * at.stage("heater", Heater(at.input("extra.power").value)).power
    return Equations(rates, {"extra.first": T[0], "extra.last": T[-1]})

@effect(summary="the heater gives no more", source="of its own")
def heater_limit(heater: Heater, limit: Expression = quantity("W", typical=5.0, null=40.0, lower=0.0)) -> Heater:
    return replace(heater, power=ca.fmin(heater.power, limit))

@effect(acts_on="rate", summary="the end touches something cold", source="Newton 1701")
def contact(rate: Rate, size: Expression = quantity("1/s", typical=5e-3, lower=0.0)) -> Rate:
    return rate.with_rate(-size * (rate["T4"] - AIR))

@effect(acts_on="rate", summary="the hot end radiates", source="Boltzmann 1884")
def radiation(rate: Rate, size: Expression = quantity("degC/s", typical=0.05, lower=0.0)) -> Rate:
    return rate.with_rate(-size * (((rate["T0"] + 273.15) / 293.15) ** 4 - ((AIR + 273.15) / 293.15) ** 4))
''',
    {"conduction": 0.03, "cooling": 2e-3, "heating": 0.03},
    {"contact": {"size": 6e-3}, "radiation": {"size": 0.1}, "heater_limit": {"limit": 20.0}},
    _rod, {"extra.first": 0, "extra.last": CELLS - 1}, {"extra.first": 0.2, "extra.last": 0.1}, (15.0, 15.0), 0.012,
    (50.0, 45.0, 40.0, 38.0, 37.0), 2400.0, 0.25, "extra.power", "W", held=True,
)  # fmt: skip

FEED, FEED_TEMPERATURE, COOLANT = 1.0, 72.0, 25.0


def _reactor(c: Case, s: np.ndarray, u: float) -> list[float]:
    species, warm = s
    reaction = c["reaction"] * np.exp(8750.0 * (1 / 350.0 - 1 / (warm + 273.15))) * species
    thinning = u / 100.0
    side, hall = c["side_reaction.size"] * species**2, c["heat_loss.size"] * (warm - 20.0)
    heat = thinning * (FEED_TEMPERATURE - warm) + c["heat"] * reaction - c["cooling"] * (warm - COOLANT)
    return [(thinning * (FEED - species) - reaction) / 60.0 - side, heat / 60.0 - hall]


REACTOR = Family(
    "reactor", "chemical", '''
@physics("reactor", summary="A stirred, cooled tank in which a species reacts.", source="Uppal, Ray & Poore 1974",
    parameters=(constant("reaction", "1/min", 0.8, lower=1e-3, summary="at 350 K"),
                constant("heat", "K l/mol", 120.0, lower=1.0), constant("cooling", "1/min", 1.0, lower=1e-2)),
    states=(state("species", "mol/l", typical=0.5, start=0.5, lower=0.0),
            state("warm", "degC", typical=20.0, start=60.0)),
    inputs={"extra.flow": "l/min"}, outputs={"extra.warm": "degC"}, held=("extra.flow",), period=180.0)
def reactor(at: Moment) -> Equations:
    reaction = at["reaction"] * ca.exp(8750 * (1 / 350 - 1 / (at["warm"] + 273.15))) * at["species"]
    thinning = at.input("extra.flow").value / 100
    heat = thinning * (72 - at["warm"]) + at["heat"] * reaction - at["cooling"] * (at["warm"] - 25)
    return Equations({"species": (thinning * (1 - at["species"]) - reaction) / 60, "warm": heat / 60},
                     {"extra.warm": at["warm"]})

@effect(acts_on="rate", summary="two of the species react", source="Guldberg & Waage 1864")
def side_reaction(rate: Rate, size: Expression = quantity("l/(mol s)", typical=5e-3, lower=0.0)) -> Rate:
    return rate.with_rate(-size * rate["species"] ** 2)

@effect(acts_on="rate", summary="the hall is colder", source="Newton 1701")
def heat_loss(rate: Rate, size: Expression = quantity("1/s", typical=2e-3, lower=0.0)) -> Rate:
    return rate.with_rate(-size * (rate["warm"] - 20))
''',
    {"reaction": 0.8, "heat": 120.0, "cooling": 1.0}, {"side_reaction": {"size": 8e-3}, "heat_loss": {"size": 4e-3}},
    _reactor, {"extra.warm": 1}, {"extra.warm": 0.1}, (90.0, 50.0), 0.012, (0.5, 60.0), 2400.0, 0.25, "extra.flow",
    "l/min", held=True,
)  # fmt: skip

LABORATORY = (ROD, REACTOR)
