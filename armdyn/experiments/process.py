"""Experiments with a process of one's own: signals for its inputs, longer recordings, other starts.

Every signal stays within the range of its input, by default that of the recordings. The signals are those of common
practice (Ljung, System Identification, 2nd ed., §13.3): a step up and down, large or small; steps at random times, a
pseudo-random binary signal; and a chirp through the frequencies that the process answers to. `expected_outcome` then
compares what each would decide.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from armdyn.errors import InputError, UnknownNameError
from armdyn.experiments.hypothesis import Hypothesis, PlannedExperiment, PredictedExperiment
from armdyn.experiments.rivals import Rivals
from armdyn.physics.simulated import SimulatedModel
from armdyn.run import Channel, Run

LONGER_RECORDING_RATIO = 3.0
"""Ratio of the duration of a longer recording to that of the last one."""
SMALL_SIGNAL_SHARE = 0.25
"""Size of a small step, and of a smaller start, as a share of the large one: what acts near rest shows there."""
LARGER_START_RATIO = 2.0
"""Ratio of the distance of a larger start, from the mean state of the last recording's second half, to that of the last
one."""
FASTEST_CHANGES_PER_PERIOD, SLOWEST_CHANGES = 4.0, 2.0
"""Highest frequency of a chirp and rate of random steps, in inverse periods of the process, and the number of cycles of
a chirp's lowest frequency that a recording contains."""
START_STD_SHARE = 0.1
"""Standard deviation of the state at the start of an experiment, as a share of the state's typical size."""
BOUND_TOLERANCE_SHARE = 0.01
"""Distance beyond the bound of a state, as a share of its typical size, that counts as rounding."""

Range = tuple[float, float]


def input_ranges(runs: Sequence[Run], inputs: Sequence[str], given: Mapping[str, Range]) -> dict[str, Range]:
    """Range of each input, in its unit: the given one, or that of the recordings.

    Raises:
        UnknownNameError: the process has no such input.
        InputError: a range is empty.
    """
    for name, (low, high) in given.items():
        if name not in inputs:
            raise UnknownNameError("input of this base", name, inputs)
        if not low < high:
            raise InputError(f"--input {name}={low:g}:{high:g}: write the smaller value first, as in {name}=0:10")
    seen = {name: np.concatenate([run.channels[name].value for run in runs]) for name in inputs}
    return {name: given.get(name, (float(v.min()), float(v.max()))) for name, v in seen.items()}


def process_experiments(
    rivals: Rivals, ranges: Mapping[str, Range], seconds: float | None = None, seed: int = 0
) -> list[PlannedExperiment]:
    """Experiments with the process of some rivals, each as long as the last recording or `seconds`.

    Args:
        rivals: the rivals.
        ranges: least and largest value of each input, in its unit.
        seconds: duration of a designed signal, s; None for that of the last recording.
        seed: seed of the random steps.
    """
    best = rivals.hypotheses[0].model
    last = rivals.last
    inputs = [name for name in best.inputs if name in last.channels]
    measured = [name for name in best.predicted_channels(last) if name in rivals.noise]
    lasted = max(float(last.channels[name].time[-1] - last.channels[name].time[0]) for name in (*inputs, *measured))
    duration = lasted if seconds is None else seconds
    period = best.oscillation_period(last, best.theta())
    begun = rivals.hypotheses[0].begun
    begins = {name: (at, START_STD_SHARE * best.parameters[name].typical) for name, at in begun.items()}

    def recorded(length: float, signals: Mapping[str, np.ndarray]) -> Run:
        channels = {name: Channel(_stamps(last.channels[name], length), signals[name], last.channels[name].unit)
                    for name in inputs}  # fmt: skip
        for name in measured:
            time = _stamps(last.channels[name], length)
            channels[name] = Channel(time, np.zeros(len(time)), last.channels[name].unit)
        return Run("experiment", channels, base_channels=last.base_channels, noise=last.noise)

    def steady(length: float) -> dict[str, np.ndarray]:
        return {
            name: np.full(len(_stamps(last.channels[name], length)), float(np.mean(last.channels[name].value)))
            for name in inputs
        }

    def planned(
        kind: str, what: str, run: Run, starts: Mapping[str, tuple[float, float]] = begins
    ) -> PlannedExperiment:
        return PlannedExperiment(kind, what, noise={n: rivals.noise[n] for n in measured}, recording=run, begins=starts)

    found, rng = list[PlannedExperiment](), np.random.default_rng(seed)
    for name in inputs:
        (low, high), unit = ranges[name], last.channels[name].unit
        time = _stamps(last.channels[name], duration)
        share, middle, half = time / duration, (low + high) / 2.0, (high - low) / 2.0
        fast = FASTEST_CHANGES_PER_PERIOD / period
        slow = min(SLOWEST_CHANGES / duration, fast)
        pulse = np.where((share >= 0.1) & (share < 0.55), 1.0, -1.0)
        random = rng.choice([-1.0, 1.0], int(np.ceil(duration * fast)) + 1)[(time * fast).astype(int)]
        chirp = np.sin(2.0 * np.pi * duration * slow * ((fast / slow) ** share - 1.0) / max(np.log(fast / slow), 1e-9))
        span, others = (
            f"{low:.3g} to {high:.3g} {unit}",
            "" if len(inputs) == 1 else ", the other inputs at their means",
        )
        small = f"{middle - SMALL_SIGNAL_SHARE * half:.3g} to {middle + SMALL_SIGNAL_SHARE * half:.3g} {unit}"
        for kind, what, size, shape in (
            ("step", f"step {name} from {span}, and back after {0.45 * duration:.3g} s", half, pulse),
            ("small_step", f"step {name} from {small}, and back", SMALL_SIGNAL_SHARE * half, pulse),
            ("steps", f"step {name} at random between {span}, every {1.0 / fast:.3g} s or more", half, random),
            ("chirp", f"sweep {name} through {span}, from {slow:.3g} to {fast:.3g} Hz", half, chirp),
        ):  # fmt: skip
            run = recorded(duration, {**steady(duration), name: middle + size * shape})
            found.append(planned(kind, f"{what}, in {duration:.3g} s{others}", run))
    again = {n: _repeated(last.channels[n], LONGER_RECORDING_RATIO * lasted) for n in inputs}
    longer = "the inputs of the last recording over and over, " if inputs else "record it again, "
    found.append(
        planned(
            "longer", f"{longer}for {LONGER_RECORDING_RATIO * lasted:.3g} s",
            recorded(LONGER_RECORDING_RATIO * lasted, again),
        )
    )  # fmt: skip
    if not inputs:
        calm = _late_state(best, last, begun)
        for kind, ratio in (("larger", LARGER_START_RATIO), ("smaller", SMALL_SIGNAL_SHARE)):
            starts = {
                n: (float(np.clip(calm[n] + ratio * (at - calm[n]), p.lower, p.upper)), std)
                for n, (at, std) in begins.items()
                for p in (best.parameters[n],)
            }
            said = ", ".join(f"{n} {at:.3g} {best.parameters[n].unit}" for n, (at, _) in starts.items())
            found.append(planned(kind, f"record it for {duration:.3g} s from {said}", recorded(duration, {}), starts))
    return found


def is_possible(hypotheses: Sequence[Hypothesis], experiment: PlannedExperiment) -> bool:
    """Whether every rival predicts finite readings, and states within the bounds that the base declares."""
    assert experiment.recording is not None, "an experiment with a process has a recording"
    for hypothesis in hypotheses:
        predicted = PredictedExperiment(hypothesis, experiment)
        with np.errstate(all="ignore"):
            if not np.isfinite(predicted.predict(predicted.start)[0]).all():
                return False
            model, theta = hypothesis.model, predicted.theta(predicted.start)
            states = model.rollout(model.input_path(experiment.recording), theta).states
        for row, name in zip(states.T, model.start_names, strict=False):
            p = model.parameters[name]
            room = BOUND_TOLERANCE_SHARE * p.typical
            if row.min() < p.lower - room or row.max() > p.upper + room:
                return False
    return True


def _stamps(channel: Channel, seconds: float) -> np.ndarray:
    """(n,) even time stamps from 0 to `seconds`, as dense as those of a channel."""
    interval = float(np.median(np.diff(channel.time)))
    return np.asarray(interval * np.arange(round(seconds / interval) + 1))


def _repeated(channel: Channel, seconds: float) -> np.ndarray:
    """(n,) values of a channel, there and back and there again, at the stamps of `_stamps`."""
    lasted = float(channel.time[-1] - channel.time[0])
    phase = np.mod(_stamps(channel, seconds), 2.0 * lasted)
    return np.interp(np.minimum(phase, 2.0 * lasted - phase), channel.time - channel.time[0], channel.value)


def _late_state(model: SimulatedModel, run: Run, begun: Mapping[str, float]) -> dict[str, float]:
    """Mean state, by name of its start value, over the second half of a run that begins at `begun`."""
    states = model.rollout(model.input_path(run), model.with_values(begun).theta()).states
    late = states[len(states) // 2 :].mean(axis=0)
    return dict(zip(model.start_names, late.tolist(), strict=False))
