"""What the report of a trial shows: plain numbers and arrays, all in SI units."""

from dataclasses import dataclass

from armdyn.channels import FloatArray
from pipeline.report.page import KeyFigure, Level
from pipeline.report.theme import Phase


@dataclass(frozen=True)
class EstimateTrace:
    """A parameter learnt during the trial.

    Attributes:
        name: such as ``"length"``.
        unit: SI unit.
        time: (k,) s, when each estimate was made.
        value: (k,) in `unit`.
        std: (k,) standard deviation that the estimator gave, in `unit`.
        guess: where it started.
        truth: None where nobody knows it.
    """

    name: str
    unit: str
    time: FloatArray
    value: FloatArray
    std: FloatArray
    guess: float
    truth: float | None = None


@dataclass(frozen=True)
class ForceTrace:
    """The load cell against the model with the final estimate.

    Attributes:
        time: (n,) s.
        measured: (n,) N.
        predicted: (n,) N; nan where the model was not run.
        noise: standard deviation of the load cell, N; None where unknown.
        residual_is_white: None where not tested; False means that intervals do not hold.
    """

    time: FloatArray
    measured: FloatArray
    predicted: FloatArray
    noise: float | None = None
    residual_is_white: bool | None = None


@dataclass(frozen=True)
class GripperTrace:
    """The string's upper end along the line.

    Attributes:
        time: (n,) s.
        reference: (n,) m, what was commanded.
        actual: (n,) m, what was measured.
    """

    time: FloatArray
    reference: FloatArray
    actual: FloatArray


@dataclass(frozen=True)
class SwingTrace:
    """Gripper and load in the vertical plane of the line during the swing.

    Attributes:
        time: (n,) s.
        gripper_x: (n,) m along the line.
        load_x: (n,) m along the line.
        load_z: (n,) m over the line, negative below.
    """

    time: FloatArray
    gripper_x: FloatArray
    load_x: FloatArray
    load_z: FloatArray


@dataclass(frozen=True)
class BoxOutline:
    """The box in the plane of the line.

    Attributes:
        near_wall: m along the line.
        width: m between its walls.
        rim: m from the line down to the rim.
        height: m from the floor to the rim.
    """

    near_wall: float
    width: float
    rim: float
    height: float


@dataclass(frozen=True)
class SwingPicture:
    """The planned swing and what became of it.

    Attributes:
        planned: from the optimiser.
        executed: as measured or simulated; None where the swing was not run.
        box: None where there is none.
        load_radius: m.
        snapshots: how many positions of the string are drawn.
    """

    planned: SwingTrace
    executed: SwingTrace | None
    box: BoxOutline | None
    load_radius: float = 0.014
    snapshots: int = 9


@dataclass(frozen=True)
class JointTrace:
    """Joints against their limits.

    Attributes:
        names: (j,).
        time: (n,) s.
        position: (n, j) rad.
        velocity: (n, j) rad/s.
        lower, upper: (j,) rad.
        speed: (j,) rad/s, largest in both directions.
    """

    names: tuple[str, ...]
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    lower: FloatArray
    upper: FloatArray
    speed: FloatArray


@dataclass(frozen=True)
class Margin:
    """The closest that the trial came to one limit.

    Attributes:
        limit: what is limited, such as ``"velocity"``.
        where: the joint or part.
        value: the extreme, in `unit`.
        bound: the limit, in `unit`.
        unit: SI unit.
        used: share of the allowed range that was used; more than 1 is a violation.
        time: s, when.
    """

    limit: str
    where: str
    value: float
    bound: float
    unit: str
    used: float
    time: float


@dataclass(frozen=True)
class NodeTiming:
    """How long one of the nodes took per step.

    Attributes:
        name: of the node.
        period: s between steps; None for one that runs once.
        steps: how often it ran.
        mean, longest: s of computing per step.
        overruns: steps that took longer than their period.
    """

    name: str
    period: float | None
    steps: int
    mean: float
    longest: float
    overruns: int = 0


@dataclass(frozen=True)
class TrialReportData:
    """Everything the report of one trial shows; a part that is None or empty is left out.

    Attributes:
        level: colour of the verdict.
        verdict: what happened, in a sentence.
        subtitle: robot, load, seed, hidden effects.
        command: how to run this trial again.
        phases: named stretches of time.
        notes: sentences to read first, such as warnings.
        key_figures: numbers beside those that follow from the other parts.
        estimates: the parameters learnt, the length first.
        force, gripper, swing, joints: recordings of the trial.
        margins: to the limits; the tightest need not come first.
        nodes: computing times.
    """

    level: Level
    verdict: str
    subtitle: str = ""
    command: str = ""
    phases: tuple[Phase, ...] = ()
    notes: tuple[str, ...] = ()
    key_figures: tuple[KeyFigure, ...] = ()
    estimates: tuple[EstimateTrace, ...] = ()
    force: ForceTrace | None = None
    gripper: GripperTrace | None = None
    swing: SwingPicture | None = None
    joints: JointTrace | None = None
    margins: tuple[Margin, ...] = ()
    nodes: tuple[NodeTiming, ...] = ()
