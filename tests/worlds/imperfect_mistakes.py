"""What people do by mistake to recordings that are imperfect as real ones are, each with its sound twin.

Worlds are those of `imperfect_pendulum` and `imperfect_arm`: sensors with errors, effects that the model lacks, guesses
for lengths and masses. Sizes are drawn, not listed: a clock is late by any time and drifts by any share. A mistake is
asked for only where it is a fair question: of a single torque where it changes most, of a zero where rigid bodies see
it; that a gripper counts the other way cannot be seen by a force alone.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from armdyn.run import Channel, Run

from . import mistakes as made
from .mistakes import Mistake
from .plant import Plant

DEGREES = 180.0 / np.pi
POUND_CENTIMETRE = 0.0980665  # N m; of a kgf cm
STRETCHED = 0.15  # of the range of a joint that sticks, by which its drive is away when it comes loose


def of_pendulum(run: Run, rng: np.random.Generator) -> Iterator[Mistake]:
    """Mistakes with a recording of a pendulum, with a fixed pivot or a moving one."""
    angular = [name for name in ("swing_angle", "swing_rate") if name in run.channels]

    def mistake(name: str, wrong: Run, *kinds: str) -> Mistake:
        return Mistake(name, wrong, " ".join(kinds))

    if angular:
        yield mistake("angle in degrees", made.scaled(run, angular, DEGREES), "angle_unit")
    if "gripper_x" not in run.channels:
        for name, size in (("zero half a turn off", np.pi), ("zero a quarter turn off", np.pi / 2)):
            if "swing_angle" in run.channels:
                yield mistake(name, made.moved(run, "swing_angle", size), "position_offset")
        return
    gripper = ["gripper_x"]
    yield mistake("gripper in cm", made.scaled(run, gripper, 100.0), "scale")
    yield mistake("gripper in mm", made.scaled(run, gripper, 1000.0), "scale")
    shift = float(rng.uniform(0.12, 0.45) * rng.choice([-1.0, 1.0]))
    yield mistake("gripper's clock shifted", made.late(run, gripper, shift), "clock_shift")
    pace = float(rng.uniform(0.01, 0.03) * rng.choice([-1.0, 1.0]))
    yield mistake("gripper's clock drifts", _paced(run, gripper, pace), "clock_shift")
    if angular:
        yield mistake("gripper's sign", made.scaled(run, gripper, -1.0), "position_sign")
        yield mistake("angle's sign", made.scaled(run, angular, -1.0), "position_sign")
    if "load_force" in run.channels:
        yield mistake("force in gram-force", made.scaled(run, ["load_force"], 1e3 / 9.80665), "torque_unit")
        yield mistake("force's sign", made.scaled(run, ["load_force"], -1.0), "torque_sign")


def of_arm(run: Run, plant: Plant, rng: np.random.Generator) -> Iterator[Mistake]:
    """Mistakes with a recording of an arm."""
    joints = list(plant.joints)
    tau, q, v = ([f"{k}.{j}" for j in joints if f"{k}.{j}" in run.channels] for k in ("tau", "q", "v"))
    varied = {name: float(np.std(run.channels[name].value)) / plant.effort[i] for i, name in enumerate(tau)}
    one = max(varied, key=lambda name: varied[name])
    moving = str(rng.choice([name for name in q if np.ptp(run.channels[name].value) > 0.3]))
    beside = [moving, *(name for name in v if name[2:] == moving[2:])]

    def mistake(name: str, wrong: Run, *kinds: str, undone: bool = True) -> Mistake:
        return Mistake(name, wrong, " ".join(kinds), undone=undone)

    yield mistake("all in degrees", made.scaled(run, q + v, DEGREES), "angle_unit")
    yield mistake("one joint in degrees", made.scaled(run, beside, DEGREES), "angle_unit")
    yield mistake("mN m", made.scaled(run, tau, 1e3), "torque_unit")
    yield mistake("one in mN m", made.scaled(run, [one], 1e3), "torque_unit")
    yield mistake("kgf cm", made.scaled(run, tau, 1.0 / POUND_CENTIMETRE), "torque_unit")
    yield mistake("gear forgotten", made.scaled(run, tau, 1.0 / float(rng.uniform(50.0, 160.0))), "torque_unit",
                  undone=False)  # fmt: skip
    currents = run
    for name, constant in zip(tau, rng.uniform(5.0, 60.0, len(tau)), strict=True):
        currents = made.scaled(currents, [name], 1.0 / float(constant))
    yield mistake("ampere", currents, "torque_unit", undone=False)
    yield mistake("all torques negated", made.scaled(run, tau, -1.0), "torque_sign")
    yield mistake("one torque negated", made.scaled(run, [one], -1.0), "torque_sign")
    sizes = made.changed(run, tau, lambda c: Channel(c.time, np.abs(c.value), c.unit))
    yield mistake("magnitudes", sizes, "sign_missing", undone=False)
    yield mistake("torques late", made.late(run, tau, float(rng.uniform(0.12, 0.4))), "clock_shift")
    yield mistake("torques' clock drifts", _paced(run, tau, float(rng.uniform(0.01, 0.03))), "clock_shift")
    weightless = without_gravity(run, plant, dict(zip(tau, joints, strict=True)))
    yield mistake("without gravity", weightless, "without_gravity", undone=False)
    smooth = made.changed(run, tau, lambda c: _low_passed(c, 0.25))
    yield mistake("low-passed", smooth, "filtered", "clock_shift", undone=False)
    farthest = max(q, key=lambda name: float(np.ptp(run.channels[name].value)))
    yield mistake("sticks at one place", _pulled(run, farthest, plant), "sticking", undone=False)
    for name, size in (("a quarter turn", np.pi / 2), ("half a turn", np.pi)):
        wrong = made.moved(run, moving, size)
        if made.tells(plant, run, wrong):
            yield mistake(name, wrong, "position_offset")
    swapped = made.renamed(run, {joints[0]: joints[1], joints[1]: joints[0]}, ["q", "v"])
    if made.tells(plant, run, swapped):
        yield mistake("positions exchanged", swapped, "joints_swapped")


def without_gravity(run: Run, plant: Plant, joint_of: Mapping[str, str]) -> Run:
    """Torques from which a controller took the weight of the arm as described."""
    channels = dict(run.channels)
    for i, name in enumerate(joint_of):
        c = run.channels[name]
        at = (run.channels[f"q.{joint}"] for joint in plant.joints)
        q = np.column_stack([np.interp(c.time, x.time, x.value) for x in at])
        channels[name] = Channel(c.time, c.value - plant.weight(q)[:, i], c.unit)
    return replace(run, channels=channels)


def _pulled(run: Run, name: str, plant: Plant) -> Run:
    """A joint that sticks in the middle of its motion, whose drive pulls with up to half of its effort."""
    right, joint = run.channels[name], name[2:]
    width = STRETCHED * float(np.ptp(right.value))
    held = made.sticky(run, name, float(np.median(right.value)), width)
    found = dict(held.channels)
    tau, behind = run.channels[f"tau.{joint}"], right.value - found[name].value
    pull = 0.5 * plant.effort[list(plant.joints).index(joint)] / width * np.interp(tau.time, right.time, behind)
    found[f"tau.{joint}"] = Channel(tau.time, tau.value + pull, tau.unit)
    if f"v.{joint}" in found:
        v = found[f"v.{joint}"]
        rate = np.gradient(found[name].value, right.time)
        found[f"v.{joint}"] = Channel(v.time, np.interp(v.time, right.time, rate), v.unit)
    return replace(run, channels=found)


def _paced(run: Run, names: list[str], pace: float) -> Run:
    """Channels whose clock runs fast by a share."""
    return made.changed(run, names, lambda c: Channel(c.time[0] + (1.0 + pace) * (c.time - c.time[0]), c.value, c.unit))


def _low_passed(c: Channel, lag: float) -> Channel:
    """After a first-order lag, s."""
    keep = float(np.exp(-np.median(np.diff(c.time)) / lag))
    return Channel(c.time, lfilter([1.0 - keep], [1.0, -keep], c.value, zi=[keep * c.value[0]])[0], c.unit)
