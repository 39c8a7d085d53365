"""Prepare recordings for a comparison with a model: check them, reduce their rate, estimate their noise."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from armdyn.errors import InputError
from armdyn.model import Model
from armdyn.recording.noise import white_noise_std
from armdyn.run import Run
from armdyn.smoothing.choice import resolution

MAX_SAMPLES_PER_CHANNEL = 5_000_000
"""Largest number of samples in a channel of a run."""
MIN_ASSUMED_NOISE_SHARE_OF_RANGE = 1e-6
"""Smallest standard deviation of the noise that is assumed for a channel, as a share of its range."""


def prepare_runs(
    model: Model, runs: Sequence[Run], held_out: Sequence[Run] = (), exam: Sequence[Run] = ()
) -> tuple[list[Run], list[Run], list[Run]]:
    """Check training, held-out and exam runs and prepare them for a comparison with a model.

    Runs are cut at gaps and, for an arm, filtered to a lower sampling rate. Held-out and exam runs do not influence
    training runs, nor exam runs any other.

    Returns:
        The prepared training, held-out and exam runs.

    Raises:
        InputError: no run is given, a run is given twice (also as a copy), a signal is constant or too short, or the
            runs contain no channel that the model predicts.
    """
    if not runs:
        raise InputError("no run given: give at least one recording")
    check_distinct({"a training run": runs, "a held-out run": held_out, "an exam run": exam})
    runs, held_out, exam = ([model.with_model_channels(run) for run in given] for given in (runs, held_out, exam))
    check_distinct_data(model, [*runs, *held_out, *exam])
    held_out, exam = ([_of_channels(model, run, runs) for run in given] for given in (held_out, exam))
    named = with_distinct_names([*runs, *held_out])
    parts = [split_at_gaps(model, run) for run in (*named, *_exam_named(exam, named))]
    beside = list(chain(*parts[: len(runs)]))
    found = [prepare_parts(model, of_run, beside) for of_run in parts]
    kinds = found[: len(runs)], found[len(runs) : len(named)], found[len(named) :]
    training, others, last = (list(chain(*kind)) for kind in kinds)
    return training, others, last


def _of_channels(model: Model, run: Run, training: Sequence[Run]) -> Run:
    """A run without what the model predicts in no training run: a drive may have been at its limit in all of them."""
    fitted = {name for one in training for name in model.predicted_channels(one)}
    beside = set(model.predicted_channels(run)) - fitted
    return model.without_predictions(run, beside) if beside else run


def _exam_named(exam: Sequence[Run], named: Sequence[Run]) -> Iterator[Run]:
    """The exam runs, each renamed where another run has its name."""
    names = {run.name for run in named}
    for i, run in enumerate(exam):
        name = run.name if run.name not in names else f"exam/{run.name}"
        name = name if name not in names else f"exam {i + 1}/{run.name}"
        names.add(name)
        yield replace(run, name=name)


def noise_std_by_run_and_channel(model: Model, runs: Sequence[Run]) -> dict[tuple[str, str], float]:
    """Standard deviation of the noise by run and channel: as the recording states it, else estimated from the samples.

    The estimate is that of white noise, from differences of neighbouring samples.
    """
    noise: dict[tuple[str, str], float] = {}
    for run in runs:
        jumps = model.jump_times(run)
        for name in model.predicted_channels(run):
            channel = run.channels[name]
            floor = max(
                MIN_ASSUMED_NOISE_SHARE_OF_RANGE * float(np.ptp(channel.value)),
                resolution(channel.value) / np.sqrt(12.0),
            )
            stated = run.noise.get(name)
            estimate = white_noise_std(channel.time, channel.value, jumps) if stated is None else stated
            noise[run.name, name] = max(estimate, floor, 1e-12)
    return noise


def stated_noise(model: Model, runs: Sequence[Run]) -> dict[tuple[str, str], float]:
    """Standard deviation of the noise that each recording states for its original samples, by run and channel."""
    stated = {run.name: run.recording.noise for run in runs}
    return {
        (run.name, name): stated[run.name][name]
        for run in runs
        for name in model.predicted_channels(run)
        if name in stated[run.name]
    }


def split_at_gaps(model: Model, run: Run) -> tuple[Run, ...]:
    """Check one run, and split it at gaps that the model cannot simulate through.

    Raises:
        InputError: the run is too long, a signal is constant or too short, or it contains no channel that the model
            predicts.
    """
    longest = max((len(channel) for channel in run.channels.values()), default=0)
    if longest > MAX_SAMPLES_PER_CHANNEL:
        raise InputError(f"{run.source or run.name}: {longest} samples are too many: cut it or record at a lower rate")
    parts = model.split_at_gaps(run)
    for part in parts:
        for name in model.predicted_channels(part):
            part.require_varying_channel(name)
    return parts


def prepare_parts(model: Model, parts: Sequence[Run], beside: Sequence[Run] = ()) -> list[Run]:
    """Prepare the parts of a run for the comparison with a model, and split them as the model simulates them.

    Args:
        model: the model of the comparison.
        parts: parts of the run between gaps; see `split_at_gaps`.
        beside: other runs of the same arm; see `Model.prepare_run`.

    Raises:
        InputError: a signal is constant or too short.
    """
    return [piece for part in parts for piece in model.split_into_pieces(model.prepare_run(part, beside))]


def check_distinct(runs: Mapping[str, Sequence[Run]]) -> None:
    """Check that no recording is given twice.

    Args:
        runs: runs by how they are used, such as ``"a training run"``, for the message.

    Raises:
        InputError: a recording is given twice.
    """
    seen: dict[object, str] = {}
    for role, those in runs.items():
        for run in those:
            identity = run.source.resolve() if run.source is not None else id(run)
            if identity in seen:
                where = run.source or run.name
                if seen[identity] == role:
                    raise InputError(f"{where}: is given twice: name every run once")
                raise InputError(f"{where}: is {role} and also {seen[identity]}: name it in one place")
            seen[identity] = role


def check_distinct_data(model: Model, runs: Sequence[Run]) -> None:
    """Check that no two runs contain the same samples, as a copy of a recording in another format does.

    Raises:
        InputError: two runs contain the same samples.
    """
    seen: dict[object, Run] = {}
    for run in runs:
        readings = tuple(run.channels[name].value.round(9).tobytes() for name in model.predicted_channels(run))
        if readings in seen:
            first = seen[readings]
            raise InputError(f"{run.source or run.name}: holds the same data as {first.source or first.name}: give one")
        seen[readings] = run


def with_distinct_names(runs: Sequence[Run]) -> list[Run]:
    """Rename runs so that their names differ: the folder is added to a file name that occurs twice."""
    names = [run.name for run in runs]
    result = []
    for i, run in enumerate(runs):
        if names.count(run.name) > 1:
            folder = run.source.resolve().parent.name if run.source is not None else str(i + 1)
            run = replace(run, name=f"{folder}/{run.name}")
        result.append(run)
    if len({run.name for run in result}) < len(result):
        result = [replace(run, name=f"{i + 1}:{run.name}") for i, run in enumerate(result)]
    return result
