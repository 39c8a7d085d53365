"""The motion of a run on the bench, in three dimensions."""

from collections.abc import Sequence

from armdyn.arm.model import ArmModel
from armdyn.run import Run
from pipeline.view.motion import arm_scene, joint_motion, swing_of, swing_scene
from pipeline.view.scene import Scene
from pipeline.view.shapes import Links, links_of
from pipeline.workbench.bench import Atom, Bench

_links: dict[str, Links] = {}
"""Of arms that were drawn already, by fingerprint: meshes take a second or two to read."""


def scene_of_run(bench: Bench, effects: Sequence[Atom], name: str | None) -> Scene:
    """What moves in a run; a load whose angle was not measured swings as the model with these effects says.

    Args:
        bench: model and runs.
        effects: that are ticked.
        name: of the run; the first one where it is None.

    Raises:
        InputError: nothing in the run says how it moves.
    """
    study = bench.study
    runs = (*study.runs, *study.held_out)
    run: Run = next((run for run in runs if run.name == name), runs[0])
    model = study.model
    if isinstance(model, ArmModel):
        robot = model.arm.robot
        if robot.fingerprint not in _links:
            _links[robot.fingerprint] = links_of(robot)
        links = _links[robot.fingerprint]
        return arm_scene(run.name, "run", links, *joint_motion(run.recording, robot))
    if run in study.runs:
        fit = bench.fit(effects)
        return swing_scene(run.name, "run", swing_of(run, model, fit))
    return swing_scene(run.name, "run", swing_of(run, model))
