"""Distances over a motion, looked at as often as the distance itself demands."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import urdf
from pipeline.motion.feasibility.bounded import Bounded
from pipeline.motion.feasibility.series import Looks
from pipeline.motion.feasibility.settings import CheckSettings, Swing
from pipeline.motion.feasibility.surroundings import Surroundings

Array = NDArray[np.float64]

SHARE = 0.25
"""Share of the distance by which the arm may move before the next look: what is touched cannot be missed."""

STEP = 5e-3
"""Move after which a look is taken even where things touch [m]."""

HAND = 0.15
"""How far the hand reaches beyond the tool frame and the arm beyond the middle of its links, at most [m]."""


def collision_series(robot: urdf.Robot, looks: Looks, settings: CheckSettings) -> list[Bounded]:
    """Distance of the arm from itself and the rest of the robot, and from what stands around it.

    Args:
        robot: the arm.
        looks: the motion.
        settings: of the check.
    """
    itself, around = urdf.CollisionModel(robot), Surroundings(robot, settings.obstacles)

    def to_itself(k: int) -> tuple[float, str]:
        found = itself.clearance(looks.fine_q[k])
        return found.distance, f"{found.first} - {found.second}"

    travel = _travel(robot, looks.fine_q)
    series = _looked_at("self_collision", looks.fine_time, travel, to_itself, settings.clearance)
    if settings.obstacles:
        series += _looked_at(
            "collision", looks.fine_time, travel, lambda k: around.clearance(looks.fine_q[k]), settings.clearance
        )
    return series


def swing_series(
    robot: urdf.Robot, line: urdf.Line, looks: Looks, swing: Swing, settings: CheckSettings
) -> list[Bounded]:
    """Tension of the string, and distance of string and load from the arm.

    Args:
        robot: the arm.
        line: of the tool point.
        looks: the motion.
        swing: of the load, during the motion.
        settings: of the check.
    """
    tension = Bounded.between("tension", "N", ("string",), swing.time, swing.tension, swing.least_tension)
    if not settings.collision:
        return [tension]
    around, along = Surroundings(robot), np.asarray(line.direction)
    angle = np.interp(looks.fine_time, swing.time, swing.angle)

    def to_arm(k: int) -> tuple[float, str]:
        return around.swing_clearance(looks.fine_q[k], along, float(angle[k]), swing.length, swing.radius)

    travel = _travel(robot, looks.fine_q)
    travel += np.concatenate([[0.0], np.cumsum(np.abs(np.diff(angle)))]) * (swing.length + swing.radius)
    return [tension, *_looked_at("swing_clearance", looks.fine_time, travel, to_arm, settings.swing_clearance)]


def _looked_at(
    limit: str, time: Array, travel: Array, distance: Callable[[int], tuple[float, str]], least: float
) -> list[Bounded]:
    """Distances at the instants that matter, a series per pair that was the closest at one of them.

    Args:
        limit: what is limited.
        time: of all samples (m,) [s].
        travel: upper bound of the way that any point of the arm has gone until each sample (m,) [m].
        distance: at a sample: how far apart which two are [m].
        least: distance that is asked for [m].
    """
    found: dict[str, list[tuple[float, float]]] = {}
    k = 0
    while k < time.size:
        apart, pair = distance(k)
        found.setdefault(pair, []).append((float(time[k]), apart))
        room = max(SHARE * (apart - least), STEP)
        following = int(np.searchsorted(travel, travel[k] + room, side="right"))
        last = time.size - 1
        k = max(following, k + 1) if k == last else min(max(following, k + 1), last)
    return [
        Bounded.between(limit, "m", (pair,), [t for t, _ in rows], [d for _, d in rows], least)
        for pair, rows in found.items()
    ]


def _travel(robot: urdf.Robot, q: Array) -> Array:
    """Upper bound of the way that any point of the arm has gone until each posture (m,) [m]."""
    lengths = [float(np.linalg.norm(robot.model.jointPlacements[j].translation)) for j in range(2, robot.model.njoints)]
    tool = robot.model.frames[robot.tool_frame_id].placement.translation
    lengths.append(float(np.linalg.norm(tool)) + HAND)
    # What hangs on a joint reaches no further than all the links after it, stretched out.
    reach = np.cumsum(lengths[::-1])[::-1]
    steps = np.abs(np.diff(q, axis=0)) @ reach
    return np.concatenate([[0.0], np.cumsum(steps)])
