"""Real robots by name: each file here that has a `DRIVER` is one; nothing else lists them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pkgutil import iter_modules

import urdf
from armdyn.errors import InputError
from pipeline.loadcell.cell import LoadCell
from pipeline.robot.protocol import RealRobot

Connect = Callable[[LoadCell | None, Callable[[], float]], RealRobot]
"""Connects to a robot: with its load cell, where there is one, and with our clock [s], on which the cell is read."""


@dataclass(frozen=True)
class Driver:
    """How robots of one kind are reached.

    Attributes:
        name: of the kind, for ``--robot NAME:ADDRESS``.
        address: what is given as the address, for help.
        reach: from address, arm (a known name or a settings file) and its description to what connects; what the
            settings lack is an `InputError` here, before anything is connected.
    """

    name: str
    address: str
    reach: Callable[[str, str, urdf.Robot], Connect]


@cache
def drivers() -> dict[str, Driver]:
    """Every driver, by name."""
    modules = [import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__)]
    return {module.DRIVER.name: module.DRIVER for module in modules if hasattr(module, "DRIVER")}


def driver_at(robot: str, address: str | None = None) -> tuple[Driver, str]:
    """The driver of ``NAME:ADDRESS``, and the address, where it is not given alone.

    Raises:
        InputError: there is no such driver, or no address.
    """
    name, _, behind = robot.partition(":")
    driver, address = drivers().get(name), address or behind
    if driver is None:
        known = " or ".join(f"'{one}'" for one in ("simulated", *drivers()))
        raise InputError(f"--robot {robot}: choose {known}")
    if not address:
        raise InputError(f"--robot {name}: say where it is: --robot {name}:ADDRESS, {driver.address}")
    return driver, address
