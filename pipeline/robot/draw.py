"""What a seed decides: how this plant differs from its label."""

from dataclasses import dataclass

import numpy as np

from pipeline.robot.protocol import Vector
from pipeline.robot.settings import PlantSettings


@dataclass(frozen=True)
class Drawn:
    """One draw of the plant.

    Attributes:
        mass: true mass of the load [kg].
        bias: zero error of the load cell [N].
        latency: of the load cell [s].
        link_scale: factor on mass and inertia of the link behind each joint (n,).
    """

    mass: float
    bias: float
    latency: float
    link_scale: Vector


def draw(settings: PlantSettings, joints: int, rng: np.random.Generator) -> Drawn:
    """Draw a plant; what the settings fix is drawn as well and dropped, so that the rest does not change with it."""
    spread = settings.inertia_spread
    link_scale = 1.0 + rng.uniform(-spread, spread, joints)
    mass = settings.mass * (1.0 + settings.mass_spread * rng.standard_normal())
    bias = settings.cell.bias_spread * rng.standard_normal()
    latency = rng.uniform(0.0, settings.cell.latency_up_to)
    link_scale.setflags(write=False)
    return Drawn(
        mass=float(mass),
        bias=float(bias) if settings.cell.bias is None else settings.cell.bias,
        latency=float(latency) if settings.cell.latency is None else settings.cell.latency,
        link_scale=link_scale,
    )
