"""Compute the missing force, which a model does not explain, as curves over the quantities on which it may depend.

For an arm it is the torque of each joint that the model lacks, measured minus predicted; for a model with states, such
as a pendulum, the acceleration. Its means over bins of speed, position, load and time form a curve that shows the law:
a step where the motion reverses is dry friction, a straight line over the speed viscous friction, a parabola drag.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.estimation.correlation import autocorrelations
from armdyn.estimation.solve import pseudo_inverses
from armdyn.identify.fit import Fit
from armdyn.identify.problem import Problem, transfer_mask, transfer_values
from armdyn.identify.state_space.grey_box import GreyBox, LinearisationPoint
from armdyn.identify.state_space.noise_evidence import evaluate_all_kicks
from armdyn.identify.state_space.output_error import EffectSetOptimiser
from armdyn.physics.simulated import as_model_with_motion, as_simulated_model
from armdyn.recording.channels import Channel, FloatArray
from armdyn.run import Run

TIME_RESOLUTION_SWING_PERIODS = 1.0 / 16.0
"""Time resolution of a missing force, in periods of the swing."""
PROCESS_NOISE_FIT_ROUNDS = 3
"""Number of rounds in which values and process noise are optimised for a missing acceleration."""
CURVE_POINT_COUNTS_TRIED = (32, 24, 16, 12, 8)
"""Numbers of points that are tried for a curve: the first for which a typical bin has `MIN_INDEPENDENT_SAMPLES_PER_BIN`
independent samples is used, else the last."""
JOINT_QUANTITIES = {"speed": "v", "position": "q", "acceleration": "a"}
"""Quantities on which a joint's torque may depend, with the first part of the name of their channels."""
MIN_INDEPENDENT_SAMPLES_PER_BIN = 4.0
"""Number of independent samples that a typical bin needs. On recordings of a UR5 with friction and a payload, eight
give curves of 8 points, in which dry friction cannot be seen beside viscous friction on three of six joints; four give
32 points, which show both on all six."""


@dataclass(frozen=True, eq=False)
class MissingForce:
    """The missing force of one run as a function of time, for one joint where the model has joints.

    Attributes:
        run: name of the run.
        joint: name of the joint; None for a model without joints.
        unit: unit of `value`: ``"N m"`` or ``"N"``, or, for a missing acceleration, ``"rad/s^2"`` or ``"m/s^2"``.
        time: (n,) times, s.
        value: (n,) missing force, torque or acceleration, in `unit`.
        against: (n,) values and unit of each quantity on which it may depend, by name, such as ``"speed"``,
            ``"position"``, ``"angle"`` or ``"load"``.
    """

    run: str
    joint: str | None
    unit: str
    time: FloatArray
    value: FloatArray
    against: Mapping[str, tuple[FloatArray, str]]


@dataclass(frozen=True, eq=False)
class ForceCurve:
    """Curve of the missing force of one run and joint over one quantity: means over bins of equally many samples.

    Attributes:
        run: name of the run.
        joint: name of the joint; None for a model without joints.
        unit: unit of the force.
        against: name of the quantity.
        x_unit: unit of that quantity.
        x: (b,) mean of the quantity in every bin, ascending.
        as_given: (b,) mean force that the model as given lacks.
        std: (b,) standard error of `as_given`, which takes the correlation of neighbouring samples into account.
        repaired: (b,) mean force that the repaired model lacks; None where nothing was repaired.
        repaired_std: (b,) standard error of `repaired`.
        with_background: (b,) mean force that the repaired model lacks with its background; None where it has none.
        law: (b,) mean force that the repair adds to the model as given; None where it was not computed.
    """

    run: str
    joint: str | None
    unit: str
    against: str
    x_unit: str
    x: FloatArray
    as_given: FloatArray
    std: FloatArray
    repaired: FloatArray | None = None
    repaired_std: FloatArray | None = None
    law: FloatArray | None = None
    with_background: FloatArray | None = None


def missing_forces(fit: Fit) -> list[MissingForce]:
    """The missing force in every fitted run of a fit, for every joint."""
    joints = {run.name: fit.problem.model.force_channels(run) for run in fit.problem.runs}
    return _torques(fit, joints) if any(joints.values()) else missing_accelerations(fit)


def force_added_by_repair(given: Fit, repaired: Fit) -> list[MissingForce]:
    """The force that a repair adds to a model, in every run, without the noise of the recordings.

    It is the missing force of the model as given if the runs were exactly what the repaired model predicts.

    Args:
        given: fit of the model as given.
        repaired: fit of the repaired model.
    """
    problem = given.problem
    runs = {run.name: run for run in problem.runs}
    for block in repaired.blocks:
        run, channel = runs[block.run], Channel(block.time, block.predicted, block.unit)
        runs[run.name] = replace(run, channels={**run.channels, block.channel: channel})
    ideal = Problem(problem.model, list(runs.values()), problem.noise, problem.settings)
    blocks = ideal.blocks(given.values, np.zeros(len(given.values), dtype=bool))
    return missing_forces(replace(given, problem=ideal, blocks=tuple(blocks)))


def missing_accelerations(fit: Fit) -> list[MissingForce]:
    """The missing acceleration in every run, for a model that simulates a motion; empty for other models.

    A smoother estimates the changes of speed (kicks) that the simulation needs, sixteen times per swing, to follow the
    measured motion. The model's values are those optimised together with this process noise.
    """
    if as_model_with_motion(fit.problem.model) is None:
        return []
    needed = fit.problem.needed_effects(fit.values, fit.free)
    problem = Problem(
        fit.problem.model.with_only_effects(needed), fit.problem.runs, fit.problem.noise, fit.problem.settings
    )
    model = as_simulated_model(problem.model)
    values = transfer_values(fit.values, fit.problem, problem)
    free = transfer_mask(fit.free, fit.problem, problem)
    begin = values
    if fit.process_noise_values is None:
        motion = EffectSetOptimiser(problem, len(problem.runs), problem.is_effect, [values])
        free, values = motion.base, motion.point.values
    else:
        free = free & ~problem.mask_of_unknowns(model.start_names)
        values = transfer_values(fit.process_noise_values, fit.problem, problem)
    box = GreyBox(problem, begin, len(problem.runs), np.zeros(len(free), dtype=bool), TIME_RESOLUTION_SWING_PERIODS)
    point = box.optimise(free, box.initial_point(values), (evaluate_all_kicks,) * PROCESS_NOISE_FIT_ROUNDS)
    found = [one for i in range(len(problem.runs)) for one in _kicked(box, point, i)]
    # A diverging simulation has no curve.
    return [
        one for one in found if all(np.isfinite(x).all() for x in (one.value, *(v for v, _ in one.against.values())))
    ]


def _kicked(box: GreyBox, point: LinearisationPoint, index: int) -> list[MissingForce]:
    """The missing acceleration of one run, for each speed of the model."""
    run, states = box.runs[index], point.states[index]
    model, theta = run.pieces.model, point.values[run.unknowns]
    around = run.linearise(point.values, states, point.sample_weights[index], np.zeros(len(point.values), dtype=bool))
    _, kicks = around.smooth(point.noises[index], np.zeros(len(point.values)))
    motion, by_start = run.pieces.start_values(theta, states)
    lasting = np.diff(run.pieces.starts)
    pushed = (pseudo_inverses(by_start) @ kicks[:, :, None])[:, :, 0]
    time, motion = run.pieces.starts[1:], motion[1:]
    found = []
    for k, joint in model.speed_states.items():
        unit = f"{model.parameters[model.start_names[k]].unit}/s".replace("/s/s", "/s^2")
        against = model.force_covariates(run.pieces.run, time, motion, k, theta) | _recorded(run.pieces.run, time)
        found.append(MissingForce(run.run.name, joint, unit, time, pushed[1:, k] / lasting, against))
    return found


def _torques(fit: Fit, joints: Mapping[str, Mapping[str, str]]) -> list[MissingForce]:
    """Measured minus predicted torque or force of every joint; `joints` by run and channel."""
    found, moving, runs = [], fit.covariates(), {run.name: run for run in fit.problem.runs}
    for block in fit.blocks:
        joint = joints[block.run].get(block.channel)
        if joint is not None:
            against = {
                name: (block.interpolate(c), c.unit)
                for name, c in ((name, moving[block.run][f"{kind}.{joint}"]) for name, kind in JOINT_QUANTITIES.items())
            }
            against["load"] = block.predicted, block.unit
            against |= _recorded(runs[block.run], block.time)
            found.append(MissingForce(block.run, joint, block.unit, block.time, block.misfit, against))
    return found


def _recorded(run: Run, time: FloatArray) -> dict[str, tuple[FloatArray, str]]:
    """Further quantities of a run at (n,) times, each with its unit."""
    return {name: (np.interp(time, c.time, c.value), c.unit) for name, c in run.extra.items()}


def force_curves(
    given: Sequence[MissingForce],
    repaired: Sequence[MissingForce] | None = None,
    law: Sequence[MissingForce] | None = None,
    with_background: Sequence[MissingForce] | None = None,
) -> tuple[ForceCurve, ...]:
    """Curves of the missing force over every quantity on which it may depend; the joint with the largest one first.

    Args:
        given: missing force of the model as given, from which the bins follow.
        repaired: missing force of the repaired model; None without a repair.
        law: force that the repair adds to the model; None to leave it out.
        with_background: missing force of the repaired model with its background; None without one.
    """
    others = [{(u.run, u.joint): u for u in of or ()} for of in (repaired, law, with_background)]
    largest = {u.joint: max(float(np.mean(o.value**2)) for o in given if o.joint == u.joint) for u in given}
    found = []
    for u in sorted(given, key=lambda u: -largest[u.joint]):
        left, gain, rest = (
            None if other is None else np.interp(u.time, other.time, other.value)
            for other in (of.get((u.run, u.joint)) for of in others)
        )
        for name, (x, x_unit) in {**u.against, "time": (u.time, "s")}.items():
            if len(x) >= CURVE_POINT_COUNTS_TRIED[-1] and np.ptp(x) > 0.0:
                found.append(_curve(u, name, x, x_unit, left, gain, rest))
    return tuple(found)


def compare_missing_forces(
    given: Fit, repaired: Fit | None = None, with_background: Fit | None = None, *, law: bool = False
) -> tuple[ForceCurve, ...]:
    """Curves of the missing force before and after a repair.

    Args:
        given: fit of the model as given.
        repaired: fit of the repaired model; None without a repair.
        with_background: fit of the repaired model with its background; None without one.
        law: whether to compute the force that the repair adds as well.
    """
    if repaired is None:
        return force_curves(missing_forces(given))
    brought = force_added_by_repair(given, repaired) if law else None
    rest = None if with_background is None else missing_forces(with_background)
    return force_curves(missing_forces(given), missing_forces(repaired), brought, rest)


def _curve(
    u: MissingForce,
    against: str,
    x: FloatArray,
    x_unit: str,
    left: FloatArray | None,
    gain: FloatArray | None,
    rest: FloatArray | None,
) -> ForceCurve:
    """The missing force as given, after repair, added by the repair, and with background, over bins of (n,) x."""
    rank = np.argsort(np.argsort(x, kind="stable"), kind="stable")
    for bins in CURVE_POINT_COUNTS_TRIED:
        if bins > max(CURVE_POINT_COUNTS_TRIED[-1], len(x) / MIN_INDEPENDENT_SAMPLES_PER_BIN):
            continue
        place = rank * bins // len(x)
        mean, std, independent = _means(place, u.value)
        if independent >= MIN_INDEPENDENT_SAMPLES_PER_BIN:
            break
    after, after_std = (None, None) if left is None else _means(place, left)[:2]
    at = np.bincount(place, x) / np.bincount(place)
    law, small = (None if y is None else np.bincount(place, y) / np.bincount(place) for y in (gain, rest))
    return ForceCurve(u.run, u.joint, u.unit, against, x_unit, at, mean, std, after, after_std, law, small)


def _means(place: np.ndarray, value: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """(b,) means of (n,) values in time order over bins, their standard errors, a typical bin's independent samples.

    The mean of n samples of variance s^2 whose autocorrelation at lag k is r_k has the variance

        s^2 / n_eff,    n_eff = n^2 / (n + 2 sum_k r_k n_k),

    n_k the number of pairs at lag k inside the bin: the force at a speed that is passed again and again is known better
    than at a speed that occurs once (after Bayley & Hammersley, J. R. Stat. Soc. Suppl. 8, 1946).

    Args:
        place: (n,) bin of every sample.
        value: (n,) samples.
    """
    count = np.bincount(place)
    mean = np.bincount(place, value) / count
    rest = value - mean[place]
    together = count.astype(np.float64)
    for lag, r in autocorrelations([rest]):
        same = place[lag:][place[lag:] == place[:-lag]]
        together += 2.0 * r * np.bincount(same, minlength=len(count))
    independent = np.maximum(count**2 / together, 2.0)
    scatter = np.bincount(place, rest**2) / count
    # The scatter of a few samples may be small by chance, so a bin has at least the typical one.
    usual = np.median(scatter[count > 1]) if np.any(count > 1) else np.var(value)
    return mean, np.sqrt(np.maximum(scatter, usual) / (independent - 1.0)), float(np.median(independent))


def pool_curves(found: Iterable[ForceCurve]) -> tuple[ForceCurve, ...]:
    """Combine the curves of all runs into one for each joint and quantity; `ForceCurve.run` is then empty.

    Neighbouring points are averaged, with weights from their standard errors, to as many points as one run has.
    """
    groups: dict[tuple[str | None, str], list[ForceCurve]] = {}
    for curve in found:
        groups.setdefault((curve.joint, curve.against), []).append(curve)
    return tuple(mine[0] if len(mine) == 1 else _together(mine) for mine in groups.values())


def _together(mine: Sequence[ForceCurve]) -> ForceCurve:
    first, points = mine[0], max(len(curve.x) for curve in mine)
    x, given, std = (np.concatenate([getattr(c, part) for c in mine]) for part in ("x", "as_given", "std"))
    order = np.argsort(x, kind="stable")
    place = np.empty(len(x), dtype=np.int64)
    place[order] = np.arange(len(x)) * points // len(x)
    weight = 1.0 / np.maximum(std, min_standard_error(std)) ** 2
    at = np.bincount(place, weight * x) / np.bincount(place, weight)
    curve = ForceCurve("", first.joint, first.unit, first.against, first.x_unit, at, *_weighted(place, given, std))
    law, small = ([getattr(c, name) for c in mine] for name in ("law", "with_background"))
    if all(part is not None for part in law):
        curve = replace(curve, law=_weighted(place, np.concatenate(law), std)[0])
    if all(part is not None for part in small):
        curve = replace(curve, with_background=_weighted(place, np.concatenate(small), std)[0])
    if any(c.repaired is None for c in mine):
        return curve
    left, left_std = (np.concatenate([getattr(c, part) for c in mine]) for part in ("repaired", "repaired_std"))
    after, after_std = _weighted(place, left, left_std)
    return replace(curve, repaired=after, repaired_std=after_std)


def _weighted(place: np.ndarray, value: FloatArray, std: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weighted means over bins of values with different standard errors, and the standard errors of the means."""
    weight = 1.0 / np.maximum(std, min_standard_error(std)) ** 2
    total = np.bincount(place, weight)
    return np.bincount(place, weight * value) / total, 1.0 / np.sqrt(total)


def min_standard_error(std: FloatArray) -> float:
    """Lower limit for the standard errors (b,) of bins, so that a bin without scatter does not get all the weight."""
    return max(1e-3 * float(np.median(std)), np.finfo(float).tiny)
