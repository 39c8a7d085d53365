"""What a model lacks: what effects would do, foretold at once from sums, and what is missing, by a process of its own.

A set of effects is foretold around the fit of the model as given; a diagnosis takes from a second to minutes.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Thread
from typing import TYPE_CHECKING, Protocol

from armdyn.channels import FloatArray
from armdyn.errors import ArmdynError
from armdyn.identify.candidate import Candidate
from armdyn.identify.fit import Fit
from armdyn.identify.study import Study
from armdyn.identify.summed import Summed
from armdyn.identify.sums import sums_at
from ik.children import begin_child
from pipeline.console.inputs import Inputs

if TYPE_CHECKING:
    from armdyn.identify.suspects import Suspect


@dataclass(frozen=True)
class Ranking:
    """An answer of `diagnose`, without its fits.

    Attributes:
        verdict: key of the contract.
        sentence: for a person.
        suspects: best first.
        remedies: what would tell tied effects apart.
        given: error by channel of the model that was diagnosed.
        units: of the channels.
        beside: labels of the effects that the model had when it was diagnosed.
    """

    verdict: str
    sentence: str
    suspects: tuple["Suspect", ...]
    remedies: tuple[str, ...]
    given: Mapping[str, float]
    units: Mapping[str, str]
    beside: tuple[str, ...] = field(default=())


class Told(Protocol):
    """Who is told how a search goes, from another thread."""

    def __call__(self, kind: str, what: object) -> None:
        """`kind` is "progress" with a sentence, "done" with a `Ranking`, or "failed" with a sentence."""


class Search:
    """One diagnosis in a process of its own.

    Args:
        inputs: files of model and runs.
        effects: labels of effects that are put into the model first.
        told: see `Told`.
    """

    def __init__(self, inputs: Inputs, effects: Sequence[str], told: Told) -> None:
        # Not forked: the server has threads, whose locks a copy of it would keep for ever.
        context = get_context("spawn")
        mine, theirs = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_search, args=(inputs, tuple(effects), theirs), daemon=True, name="armdyn-search"
        )
        self._stopped = False
        self._process.start()
        theirs.close()
        Thread(target=self._listen, args=(mine, told), daemon=True).start()

    def stop(self) -> None:
        """End it, and tell nobody."""
        self._stopped = True
        self._process.kill()

    def _listen(self, answers: Connection, told: Told) -> None:
        kind, what = "failed", "The search ended before it had an answer: start it again."
        try:
            while True:
                kind, what = answers.recv()
                if kind != "progress":
                    break
                if not self._stopped:
                    told(kind, what)
                kind, what = "failed", "The search ended before it had an answer: start it again."
        except (EOFError, OSError):
            pass
        self._process.join()
        if not self._stopped:
            told(kind, what)


def rank(inputs: Inputs, effects: Sequence[str], say: Callable[[str], None]) -> Ranking:
    """Diagnose a model with some effects put in.

    Raises:
        InputError: something cannot be used.
    """
    from armdyn.effects.catalogue import find
    from armdyn.identify.diagnose import diagnose
    from armdyn.identify.study import Study

    given = inputs.read()
    study = given.study
    if effects:
        model = study.model
        for label in effects:
            model = model.with_effect(find(label, given.catalogue))
        study = Study(model, study.runs, study.held_out, given.catalogue)
    found = diagnose(study, say)
    channels = found.comparison.channels
    return Ranking(
        verdict=found.verdict.key,
        sentence=found.sentence,
        suspects=found.suspects,
        remedies=found.remedies,
        given={name: channel.rmse for name, channel in channels.items()},
        units={name: channel.unit for name, channel in channels.items()},
        beside=tuple(effects),
    )


def _search(inputs: Inputs, effects: tuple[str, ...], answers: Connection) -> None:
    """In the process: what it finds goes through the pipe."""
    begin_child()
    os.nice(5)  # the page comes first
    try:
        found = rank(inputs, effects, lambda what: answers.send(("progress", what)))
        answers.send(("done", found))
    except ArmdynError as error:
        answers.send(("failed", str(error)))
    except Exception as error:
        answers.send(("failed", f"The search failed with {type(error).__name__}: {' '.join(str(error).split())}"))


Residuals = Mapping[tuple[str, str], FloatArray]
"""By run and channel: (n,) measured minus predicted, in the channel's unit."""


@dataclass(frozen=True, eq=False)
class Foretold:
    """A set of effects, fitted by sums.

    Attributes:
        residuals: of the runs whose prediction follows the expansion.
        values: (P,) of the study's unknowns.
    """

    residuals: Residuals
    values: FloatArray


class Foretelling:
    """Fits of sets of effects by one expansion.

    Exact for an arm's effects that are linear, and its links and payloads; for a pendulum near the fit of the model as
    given, so that a refit follows.
    """

    def __init__(self, study: Study, first: Fit) -> None:
        self._study = study
        self._linear = bool(study.model.linear)
        self._around = study.appraiser(first) if self._linear else _around(study, first)

    def of(self, effects: Sequence[Candidate]) -> Foretold:
        """What these effects would leave.

        Args:
            effects: of the study's candidates, each on one joint.
        """
        sums = self._around.sums
        columns, change, values = self._around.minimum(effects)
        residuals = {
            (sums.runs[sums.run[unit]], sums.channels[sums.channel[unit]]): sums.residual(unit, columns, change)
            for unit in range(len(sums.count))
            if self._linear or sums.training[unit]
        }
        return Foretold(residuals, self._study.own(values, sums.problem))


def _around(study: Study, first: Fit) -> Summed:
    """An expansion with every effect at the fit of a model that is not linear in them."""
    problem = study.problem
    candidates = tuple(atom for c in study.candidates for atom in c.apart())
    base = problem.fitted & ~problem.of([name for c in study.candidates for name in c.names])
    return Summed(sums_at(first, problem.blocks(first.values)), base, candidates)
