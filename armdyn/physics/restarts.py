r"""Predict an unstable motion in short pieces, each from the state that fits its own samples best.

Over a whole recording of a process that a controller holds, a simulation from its first state diverges with any values.
In pieces in which errors grow little it does not. The state s at the beginning of a piece is a nuisance: with the
derivatives X by s, Y by the parameters, and the noise W, the prediction at the best state depends on the parameters by

    Y - X (X' W X)^+ X' W Y     (variable projection: Kaufman, BIT 15, 1975).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from armdyn.estimation.descent import descend_each
from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.solve import pseudo_inverses
from armdyn.model import Prediction, prediction_from_channels
from armdyn.physics.pieces import LinearisedRun, MotionPieces
from armdyn.physics.simulated import SimulatedModel
from armdyn.recording.noise import NoiseByChannel, noise_std_from_differences
from armdyn.run import Run

STATE_STEPS = 4
"""Number of Gauss-Newton steps for the state of a piece, in which predictions are nearly linear."""
MAX_GROWTH = 10.0
"""Largest factor by which an error of the state may grow in a piece."""


def predict_in_pieces(model: SimulatedModel, run: Run, theta: np.ndarray, length: float) -> Prediction:
    """Predict the channels of a run whose motion is measured, in pieces of about `length` s with states of their own.

    Args:
        model: the model.
        run: the run.
        theta: (p,) parameters in the order of the model's names.
        length: length of a piece, s.
    """
    pieces, found = MotionPieces(model, run, length), list[LinearisedRun]()

    def linearise(states: np.ndarray) -> NormalEquations:
        found[:] = [pieces.linearise(theta, states)]
        noise = {c: noise_std_from_differences(s.time, s.measured) or 1.0 for c, s in found[0].samples.items()}
        return piece_equations(found[0], noise, len(states))

    begun = measured_states(pieces, theta)
    best, n = descend_each(linearise, begun, STATE_STEPS), begun.shape[1]
    if not best.linearised_last:
        linearise(best.values)
    gram = best.equations.gram
    by_theta = -pseudo_inverses(gram[:, :n, :n]) @ gram[:, :n, n:]
    parts = []
    for channel, s in found[0].samples.items():
        slopes = s.by_theta + np.einsum("Ni,Nip->Np", s.by_state, by_theta[s.piece])
        parts.append((channel, s.time, s.predicted, slopes))
    return prediction_from_channels(parts)


def measured_states(pieces: MotionPieces, theta: np.ndarray) -> np.ndarray:
    """(J, n) measured states at the beginning of pieces of a run whose motion is measured."""
    swing = pieces.model.oscillation_period(pieces.run, theta)
    begin = pieces.model.measured_motion(pieces.run, pieces.starts, theta, swing)
    assert begin is not None, "the motion is not measured"
    return pieces.states(theta, begin)


def restart_seconds(model: SimulatedModel, runs: Sequence[Run], noise: NoiseByChannel) -> float | None:
    """Time, s, in which an error of the state grows by `MAX_GROWTH`; None where whole runs can be predicted.

    That is where no error of the size of the noise grows to the size of the motion within a run.

    Args:
        model: the model.
        runs: the runs.
        noise: standard deviation of a sample by run and channel, in the channel's unit.
    """
    theta, fastest = model.theta(), 0.0
    for run in runs:
        rate = error_growth_rate(model, run, theta)
        if rate is not None:
            shown = {name: run.channels[name] for name in model.predicted_channels(run)}
            clear = max(float(np.ptp(c.value)) / noise[run.name, name] for name, c in shown.items())
            seconds = max(float(c.time[-1] - c.time[0]) for c in shown.values())
            fastest = max(fastest, rate if rate * seconds > np.log(clear) else 0.0)
    return float(np.log(MAX_GROWTH)) / fastest if fastest > 0.0 else None


def error_growth_rate(model: SimulatedModel, run: Run, theta: np.ndarray) -> float | None:
    """Mean rate, 1/s, at which an error of the start state grows along the measured motion of a run.

    Negative where errors fade, and None without states, and where the motion is not measured or diverges in a piece.

    Args:
        model: the model.
        run: the run.
        theta: (p,) parameters in the order of the model's names.
    """
    if not model.start_names:
        return None
    swing = model.oscillation_period(run, theta)
    pieces = MotionPieces(model, run, 0.125 * swing)
    if model.measured_motion(run, pieces.starts, theta, swing) is None:
        return None
    found = pieces.linearise(theta, measured_states(pieces, theta), np.zeros(0, dtype=int))
    _, by_start = pieces.start_values(theta, measured_states(pieces, theta))
    size = by_start * np.array([model.parameters[name].typical for name in model.start_names])
    steps = pseudo_inverses(size) @ found.transition @ size
    if not np.isfinite(steps).all():
        return None
    product, logarithm = np.eye(steps.shape[1]), 0.0
    for step in steps:
        product = step @ product
        norm = max(float(np.abs(product).max()), np.finfo(float).tiny)
        product, logarithm = product / norm, logarithm + float(np.log(norm))
    return logarithm / (float(run.channels[pieces.channels[0]].time[-1]) - float(pieces.starts[0]))


def piece_equations(found: LinearisedRun, noise: Mapping[str, float], count: int) -> NormalEquations:
    """Equations of the state and the parameters in each piece; a piece that diverges has an infinite error.

    Args:
        found: the linearised run.
        noise: standard deviation of a sample by channel, in the channel's unit.
        count: number of pieces.
    """
    parts = [
        NormalEquations.of_groups(
            np.hstack([s.by_state, s.by_theta]), s.measured - s.predicted, noise[channel], s.piece, count
        )
        for channel, s in found.samples.items()
    ]
    total = NormalEquations.stacked(parts).grouped(np.tile(np.arange(count), len(parts)), count)
    return replace(total, square=np.nan_to_num(total.square, nan=np.inf))
