r"""Cut a run into pieces, each of which is simulated from its own start state, with exact derivatives by that state.

In a simulation over a whole recording an error of the model grows until the end. In pieces that start at the measured
motion it does not, and predictions are nearly linear in all unknowns. The difference between the end of a
piece and the beginning of the next is the model's error (multiple shooting: Bock, Proc. IFAC 1981).
"""

from copy import copy
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from armdyn.estimation.solve import pseudo_inverses
from armdyn.physics.recorded import InputPath
from armdyn.physics.shooting import piece_simulator, simulate_pieces
from armdyn.physics.simulate import System
from armdyn.physics.simulated import SimulatedModel
from armdyn.readout import InterpolatingSampler
from armdyn.run import Run

INVERSION_STEPS = 3
"""Number of Newton steps with which start values of a motion are computed from a state."""
MAX_PIECES_PER_SAMPLE = 3
"""Number of pieces on which one sample may depend: its own, the previous one (by a sensor's memory) and the next one
(by interpolation)."""
LOST_SHARE = 1e-8
"""Share of a state's deviation at the beginning of a piece that is left at its end, below which it is lost."""
SAMPLES_AT_ONCE = 2**13
"""Number of samples whose derivatives are computed at once; they take a few MB."""
MIN_STEPS_PER_PIECE = 4
"""Number of steps of the shortest piece, so that samples can be interpolated between its nodes."""


@dataclass(frozen=True, eq=False)
class LinearisedRun:
    """Linearisation of a run about a motion of J pieces, with n states and k parameters.

    Attributes:
        transition: (J, n, n) derivative of the state at the end of a piece by that at its beginning.
        by_theta: (J, n, k) derivative of the state at the end of a piece by the parameters.
        end_states: (J, n) states at the ends of the pieces.
        fixed_motion_derivatives: (2, J, n, k) derivatives of the states at the beginnings and at the ends by the
            parameters, with positions and rates kept constant: a momentum is a mass times a rate.
        samples: samples and predictions by channel; see `ChannelSamples`.
    """

    transition: np.ndarray
    by_theta: np.ndarray
    end_states: np.ndarray
    fixed_motion_derivatives: np.ndarray
    samples: dict[str, "ChannelSamples"]


@dataclass(frozen=True, eq=False)
class ChannelSamples:
    """Samples of one channel of a run that was cut into pieces, with their predictions.

    Attributes:
        piece: (N,) index of each sample's piece.
        time: (N,) times, s.
        measured: (N,) measured values.
        predicted: (N,) predicted values.
        by_state: (N, n) derivative of the prediction by the state at the beginning of the piece.
        by_theta: (N, k) derivative of the prediction by the parameters.
    """

    piece: np.ndarray
    time: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    by_state: np.ndarray
    by_theta: np.ndarray


class MotionPieces:
    """A run cut into pieces of about equal length.

    Args:
        model: the model with all its effects.
        run: the prepared run.
        length: length of a piece, s.

    Attributes:
        starts: (J,) times at which the pieces begin, s.
    """

    def __init__(self, model: SimulatedModel, run: Run, length: float) -> None:
        self.model, self.run = model, run
        self.channels = model.predicted_channels(run)
        self._path = model.input_path(run)
        self._driven: tuple[bytes, InputPath] | None = None
        begin = min(float(run.channels[c].time[0]) for c in self.channels)
        end = max(float(run.channels[c].time[-1]) for c in self.channels)
        path = self._path
        most = path.nodes.shape[1] - 1
        first = int(np.clip(np.floor((begin - path.start) / path.dt + 1e-6), 0, most - 1))
        last = int(np.clip(np.ceil((end - path.start) / path.dt - 1e-6), first + 1, most))
        count = max(1, round((last - first) * path.dt / length))
        count = min(count, max(1, (last - first) // MIN_STEPS_PER_PIECE))
        self._cut(np.unique(np.round(np.linspace(first, last, count + 1)).astype(int)))

    def _cut(self, edges: np.ndarray) -> None:
        """Set the nodes of the inputs at which pieces begin and end."""
        self.edges = edges
        self.starts = self._path.start + self._path.dt * edges[:-1]
        self._of = {c: self._placed(self.run.channels[c].time) for c in self.channels}
        nodes = self._path.start + self._path.dt * np.arange(edges[0], edges[-1] + 1)
        given = ((c, self.run.channels[c].time, self.run.spread.get(c, 0.0)) for c in self.channels)
        self._samplers = {c: InterpolatingSampler(nodes, time, spread) for c, time, spread in given}

    def split_marked_pieces(self, which: np.ndarray) -> bool:
        """Cut the pieces that `which` (J,) marks into halves, if long enough; return whether any piece was cut."""
        long = which & (np.diff(self.edges) >= 2 * MIN_STEPS_PER_PIECE)
        if long.any():
            self._cut(np.unique(np.concatenate([self.edges, (self.edges[:-1] + self.edges[1:])[long] // 2])))
        return bool(long.any())

    def for_model(self, model: SimulatedModel) -> "MotionPieces":
        """Copy of these pieces of a recorded motion for a model with the same states and other effects."""
        found = copy(self)
        found.model, found._driven = model, None
        return found

    def __len__(self) -> int:
        return len(self.starts)

    def _placed(self, time: np.ndarray) -> np.ndarray:
        """(N,) piece of each sample; samples outside the inputs belong to the first or last piece."""
        inner = self._path.start + self._path.dt * (self.edges[1:-1] - 1e-6)
        return np.searchsorted(inner, time, side="right")

    def states(self, theta: np.ndarray, begin: np.ndarray) -> np.ndarray:
        """(J, n) states at the beginning of the pieces.

        Args:
            theta: (q,) parameters in the order of the model's names.
            begin: (J, starts) start values of the motion, at the beginning of every piece.
        """
        system, physics, path = self._given(theta)
        many = np.repeat(physics[:, None], len(begin), axis=1)
        found = system.initial.map(len(begin))(
            *begin.T[:, None], path.nodes[: system.input_count, self.edges[:-1]], many
        )
        return np.asarray(found).T

    def rolled_out_states(self, theta: np.ndarray, first: int = 0, state: np.ndarray | None = None) -> np.ndarray:
        """Simulate from piece `first` to the end; return (J - first, n) states at the beginning of the pieces.

        Args:
            theta: (q,) parameters in the order of the model's names.
            first: index of the piece at which it starts.
            state: (n,) state at the beginning of this piece; None means the state by the model's start values.
        """
        system, physics, path = self._given(theta)
        if state is None:
            state = self.start_state(theta)[0]
        a = self.edges[first]
        simulator = piece_simulator(system, self.model.formulation, self.channels)
        return simulator.rollout_with_impulse(path.segment(a), physics, *state).states[self.edges[first:-1] - a]

    def states_after_cut(self, theta: np.ndarray, edges: np.ndarray, states: np.ndarray) -> np.ndarray:
        """(J', n) states at the beginning of the pieces after some pieces were cut, from the states before.

        Args:
            theta: (q,) parameters in the order of the model's names.
            edges: (J + 1,) nodes at which pieces began and ended before the cut.
            states: (J, n) states at the beginning of the pieces before the cut; simulation gives those inside a piece.
        """
        if len(edges) == len(self.edges):
            return states
        system, physics, path = self._given(theta)
        simulator = piece_simulator(system, self.model.formulation, self.channels)
        found = []
        for first, last, state in zip(edges[:-1], edges[1:], states, strict=True):
            inside = self.edges[(self.edges >= first) & (self.edges < last)] - first
            alone = len(inside) == 1
            motion = (
                state[None]
                if alone
                else simulator.rollout_with_impulse(path.segment(first, last), physics, *state).states
            )
            found.append(motion[inside])
        return np.concatenate(found)

    def start_state(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The state at the start of the run, computed from the model's start values.

        Returns:
            (n,) state, its (n, starts) derivatives by the start values, and its (n, q) derivatives by theta.
        """
        system, physics, path = self._given(theta)
        start = [float(theta[self.model.names.index(name)]) for name in self.model.start_names]
        state, by_start, by_physics = _beginning(system)(
            *start, path.nodes[: system.input_count, self.edges[0]], physics
        )
        by_theta = np.zeros((system.state_count, len(theta)))
        by_theta[:, self.model.parameter_positions[1]] = np.asarray(by_physics)
        return np.asarray(state).ravel(), np.asarray(by_start), by_theta

    def start_values(
        self, theta: np.ndarray, states: np.ndarray, near: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """(K, starts) start values of motions with given states, and (K, n, starts) derivatives of the states by them.

        Args:
            theta: (p,) parameters in the order of the model's names.
            states: (K, n) states at the beginning of the first K pieces.
            near: (K, starts) start values that those without influence keep; None for zero.
        """
        starts, by_start, _ = self._inverted(theta, states, self.edges[: len(states)], near)
        return starts, by_start

    def _defined(self, theta: np.ndarray, states: np.ndarray, nodes: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """(K, n, k) derivatives for a fixed motion, of (K, n) states at (K,) nodes; see `LinearisedRun`."""
        result = np.zeros((*states.shape, len(wanted)))
        if len(wanted) and states.size and np.isfinite(states).all():
            own, of_physics = self._physical(wanted)
            _, by_start, by_physics = self._inverted(theta, states, nodes)
            free = np.abs(by_start).sum(axis=2) > 0.0
            result[:, :, own] = (by_physics * free[:, :, None])[:, :, of_physics]
        return result

    def _inverted(
        self, theta: np.ndarray, states: np.ndarray, nodes: np.ndarray, near: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(K, starts) start values of motions with (K, n) states; derivatives of the states by them and by physics."""
        system, physics, path = self._given(theta)
        K, n = states.shape
        at, many = _beginning(system).map(K), np.repeat(physics[:, None], K, axis=1)
        starts = np.zeros((K, system.start_value_count)) if near is None else near
        for _ in range(INVERSION_STEPS):
            found, by_start, by_physics = at(*starts.T[:, None], path.nodes[: system.input_count, nodes], many)
            slopes = np.asarray(by_start).reshape(n, K, system.start_value_count).transpose(1, 0, 2)
            starts = starts + (pseudo_inverses(slopes) @ (states - np.asarray(found).T)[:, :, None])[:, :, 0]
        return starts, slopes, np.asarray(by_physics).reshape(n, K, len(physics)).transpose(1, 0, 2)

    def _given(self, theta: np.ndarray) -> tuple[System, np.ndarray, InputPath]:
        physics = theta[self.model.parameter_positions[1]]
        if self._driven is None or self._driven[0] != physics.tobytes():
            self._driven = physics.tobytes(), self.model.simulation_inputs(self._path, physics)
        return self.model.system, physics, self._driven[1]

    def linearise(self, theta: np.ndarray, states: np.ndarray, wanted: np.ndarray | None = None) -> LinearisedRun:
        """Linearise the predictions of the run about given states and parameters.

        Args:
            theta: (q,) parameters.
            states: (J, n) states at the beginning of the pieces.
            wanted: (k,) indices of the parameters for which derivatives are needed; None means all.
        """
        system, physics, path = self._given(theta)
        wanted = np.arange(len(theta)) if wanted is None else wanted
        simulator = piece_simulator(system, self.model.formulation, self.channels)
        n, q, J = system.state_count, len(physics), len(self)
        shot = simulate_pieces(simulator, path, self.edges, physics, states)
        transition, ends = shot.transition, shot.end_states
        signal = np.zeros((*shot.outputs.shape, 1 + q + MAX_PIECES_PER_SAMPLE * n))
        signal[:, :, 0], signal[:, :, 1 : 1 + q] = shot.outputs, shot.outputs_by_theta
        piece = np.minimum(np.searchsorted(self.edges, self.edges[0] + np.arange(len(signal)), side="right") - 1, J - 1)
        for k in range(MAX_PIECES_PER_SAMPLE):
            own = piece % MAX_PIECES_PER_SAMPLE == k
            signal[own, :, 1 + q + n * k : 1 + q + n * (k + 1)] = shot.by_state[own]
        outputs, slopes = simulator.with_impulse_force(signal[:, :, 0], signal[:, :, 1:], physics, path.dt)
        count = len(self.channels)
        signal[:, :count, 0], signal[:, :count, 1:] = outputs, slopes
        own, of_physics = self._physical(wanted)
        by_theta = np.zeros((J, n, len(wanted)))
        by_theta[:, :, own] = shot.by_theta[:, :, of_physics]
        edges = np.concatenate([self.edges[:-1], self.edges[1:]])
        definition = self._defined(theta, np.concatenate([states, ends]), edges, wanted).reshape(2, J, n, len(wanted))
        # A sample that also depends on a neighbouring piece depends on its motion, at another state.
        following = np.append(definition[0, 1:], definition[1, -1:], axis=0)
        join = _Join(transition, by_theta - definition[1] + following, ends - np.append(states[1:], ends[-1:], axis=0))
        samples = {c: self._samples(c, signal[:, k], physics, wanted, join) for k, c in enumerate(self.channels)}
        return LinearisedRun(transition, by_theta, ends, definition, samples)

    def _physical(self, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which of (k,) parameters belong to the physics, and where each of these is among the physics' parameters."""
        physics = np.asarray(self.model.parameter_positions[1], dtype=int)
        own = np.flatnonzero(np.isin(wanted, physics))
        order = np.argsort(physics)
        return own, order[np.searchsorted(physics[order], wanted[own])]

    def _samples(
        self, channel: str, signal: np.ndarray, physics: np.ndarray, wanted: np.ndarray, join: "_Join"
    ) -> ChannelSamples:
        """Sensor readings of (K, 1 + q + 3 n) signals at the pieces' nodes, with `wanted` derivatives."""
        sensor, given = self.model.system.sensors[channel], self.run.channels[channel]
        sampler = self._samplers[channel]
        read = sensor.read(signal, sampler, physics) if sensor.lags or sensor.delays else None
        N, n = len(given), join.by_theta.shape[1]
        value, by_state, by_theta = np.empty(N), np.empty((N, n)), np.zeros((N, len(wanted)))
        back = pseudo_inverses(join.transition, LOST_SHARE)
        own, of_physics = self._physical(wanted)
        kept = np.concatenate([[0], 1 + of_physics, np.arange(1 + len(physics), signal.shape[1])])
        signal = signal[:, kept] if read is None else signal
        for some in (slice(first, first + SAMPLES_AT_ONCE) for first in range(0, N, SAMPLES_AT_ONCE)):
            these = sampler.matrix(0.0)[some] @ signal if read is None else read[some][:, kept]
            by_theta[some, own] = these[:, 1 : 1 + len(own)]
            around = these[:, 1 + len(own) :].reshape(len(these), MAX_PIECES_PER_SAMPLE, n)
            value[some], by_state[some], more = join.seen(self._of[channel][some], these[:, 0], around, back)
            by_theta[some] += more
        return ChannelSamples(self._of[channel], given.time, given.value, value, by_state, by_theta)


@dataclass(frozen=True, eq=False)
class _Join:
    """Continuity of pieces: the end of one is the beginning of the next, up to a gap.

    Attributes:
        transition: (J, n, n) matrices A.
        by_theta: (J, n, q) matrices B, for the next piece's motion.
        gap: (J, n) difference between the next piece's beginning and the end; 0 for the last.
    """

    transition: np.ndarray
    by_theta: np.ndarray
    gap: np.ndarray

    def seen(
        self,
        piece: np.ndarray,
        value: np.ndarray,
        around: np.ndarray,
        back: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Samples as functions of the beginning of their own piece alone.

        A sensor's memory of the piece before is a function of that piece's beginning, and an interpolation across the
        end of a piece depends on the next one's beginning. With s' = A s + B theta + gap both follow from the own one.

        Args:
            piece: (N,) index of each sample's piece.
            value: (N,) predicted values.
            around: (N, 3, n) derivatives by the beginnings of pieces, with piece j at index j modulo 3.
            back: (J, n, n) inverse transitions.

        Returns:
            (N,) predicted values; (N, n) derivatives by the own beginning; (N, q) additions to those by the parameters.
        """
        rows = np.arange(len(piece))
        own, before, after = (around[rows, (piece + k) % MAX_PIECES_PER_SAMPLE] for k in (0, -1, 1))
        last = np.maximum(piece - 1, 0)
        before = np.einsum("Ni,Nij->Nj", np.where(piece[:, None] > 0, before, 0.0), back[last])
        after = np.where(piece[:, None] < len(self.gap) - 1, after, 0.0)
        by_state = own + before + np.einsum("Ni,Nij->Nj", after, self.transition[piece])
        value = value - np.sum(before * self.gap[last], axis=1) + np.sum(after * self.gap[piece], axis=1)
        more = np.einsum("Ni,Niq->Nq", after, self.by_theta[piece]) - np.einsum(
            "Ni,Niq->Nq", before, self.by_theta[last]
        )
        return value, by_state, more


@lru_cache(maxsize=64)
def _beginning(system: System) -> ca.Function:
    """A function ``(start, ..., w, theta) -> state, its derivatives by the starts, by theta``."""
    start = [ca.SX.sym(f"start{i}") for i in range(system.start_value_count)]
    given, theta = ca.SX.sym("w", system.input_count), ca.SX.sym("theta", len(system.names))
    state = system.initial(*start, given, theta)
    by_start = ca.densify(ca.jacobian(state, ca.vertcat(ca.SX(0, 1), *start)))
    return ca.Function(
        "beginning", [*start, given, theta], [ca.densify(state), by_start, ca.densify(ca.jacobian(state, theta))]
    )
