"""`armdyn diagnose`: which effect a model lacks."""

from dataclasses import replace

from armdyn.document import Document, NextStep
from pipeline.console.inputs import Inputs, checked, stopped_if_wrong
from pipeline.console.options import JsonOption, ReportOption
from pipeline.console.repaired import REPAIRED
from pipeline.console.screen import finish, spinner

PANEL = "What a model lacks"


def diagnose(
    inputs: Inputs,
    report: ReportOption = None,
    json_file: JsonOption = None,
) -> None:
    """Find out which physical effect is missing, with an honest verdict."""
    from armdyn.identify.diagnose import diagnose as find_missing
    from armdyn.identify.repair import fitted_model
    from pipeline.answers import diagnosis_answer

    inputs.check(report, json_file)
    with stopped_if_wrong(json_file), spinner() as say:
        given = inputs.read()
        found = find_missing(given.study, say)
        given.require_plausible(fitted_model(given.study, found.search.last))

    def page() -> Document:
        from pipeline.report.repair import diagnosis_report

        return diagnosis_report(given.study, found)

    steps = []
    moved = all("gripper_x" in run.channels for run in given.study.runs)
    if found.remedies and given.study.model.base == "pendulum" and moved:
        command = inputs.command("next", "--output", "motion.csv", "--report", "next.html")
        steps.append(NextStep("tell them apart", command))
    if found.suspects:
        steps.append(NextStep("add it", inputs.command("repair", *REPAIRED)))
    finish(
        replace(found.document(), verdict=f"{found.verdict.key}: {found.sentence}", next_steps=steps),
        lambda: {**diagnosis_answer(given.study, found), **checked(given)},
        json_file,
        report,
        page,
    )
