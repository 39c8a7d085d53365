"""Drivers of real robots by name: every module of this package that defines `DRIVER` is found automatically."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pkgutil import iter_modules

import urdf
from armdyn.errors import InputError
from pipeline.loadcell.cell import LoadCell
from pipeline.robot.protocol import RealRobot

ConnectFunction = Callable[[LoadCell | None, Callable[[], float]], RealRobot]
"""Function that connects to a robot, from its load cell (None for none) and the clock of this program [s]."""


@dataclass(frozen=True)
class Driver:
    """Driver for one kind of robot, such as robots behind rosbridge.

    Attributes:
        name: name of the kind, for ``--robot NAME:ADDRESS``.
        address: form of the address, for help texts.
        reach: function from address, arm (known name or settings file) and description of the arm to a function that
            connects; it raises an `InputError` for incomplete settings, before any connection.
    """

    name: str
    address: str
    reach: Callable[[str, str, urdf.Robot], ConnectFunction]


@cache
def known_drivers() -> dict[str, Driver]:
    """All drivers, by name."""
    modules = [import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__)]
    return {module.DRIVER.name: module.DRIVER for module in modules if hasattr(module, "DRIVER")}


def driver_and_address(robot: str, address: str | None = None) -> tuple[Driver, str]:
    """The driver and the address that the option ``--robot NAME:ADDRESS`` names.

    Args:
        robot: value of the option; the address may be missing.
        address: address that was given separately; None for the one in `robot`.

    Raises:
        InputError: there is no such driver, or no address.
    """
    name, _, behind = robot.partition(":")
    driver, address = known_drivers().get(name), address or behind
    if driver is None:
        known = " or ".join(f"'{one}'" for one in ("simulated", *known_drivers()))
        raise InputError(f"--robot {robot}: choose {known}")
    if not address:
        raise InputError(f"--robot {name}: say where it is: --robot {name}:ADDRESS, {driver.address}")
    return driver, address
