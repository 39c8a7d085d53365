"""The state of the page without the page: what is predicted at once is what a fit finds."""

from pathlib import Path

import numpy as np
import pytest
from worlds.baxter import JOINTS
from worlds.pendulum import Setup, record

from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError, UnknownNameError
from armdyn.identify.studies import make_study
from armdyn.model_file import base_pendulum, read_model_file
from pipeline import exports
from pipeline.console.inputs import ModelAndRunInputs
from pipeline.report.overlay import FITTED_RUN, HELD_OUT_RUN, prediction_quality
from pipeline.workbench import panels
from pipeline.workbench.bench import Workbench
from pipeline.workbench.files import WritableFileCheck, save_model

from .conftest import HIDDEN, RIVALS

FRICTION = [f"{HIDDEN}:{joint}" for joint in JOINTS]


def labels_of(bench, effect):
    return [label for label, one in bench.candidates.items() if one.effect == effect]


def error(state, kind=FITTED_RUN):
    return prediction_quality([curve for curve in state.curves if curve.kind == kind], 1).rmse


def test_the_hidden_effect_leaves_less_than_any_other(bench):
    left = {name: error(bench.predict(labels_of(bench, name)), HELD_OUT_RUN) for name in (HIDDEN, *RIVALS)}
    assert min(left, key=left.get) == HIDDEN
    assert left[HIDDEN] < 0.2 * error(bench.given_state, HELD_OUT_RUN)


def test_what_is_predicted_of_an_arm_is_what_a_refit_finds(bench):
    effects = [*FRICTION, "payload:right_w2"]
    predicted, fitted = bench.predict(effects), bench.refit(effects)
    assert (predicted.how, fitted.how) == ("predicted", "fitted")
    for before, after in zip(predicted.curves, fitted.curves, strict=True):
        noise = before.noise
        assert np.abs(before.residuals[1] - after.residuals[1]).max() < 0.5 * noise
        assert np.array_equal(before.residuals[0], after.residuals[0])
    assert not predicted.stale
    nothing = bench.predict([])
    assert all(np.array_equal(curve.residuals[0], curve.residuals[1]) for curve in nothing.curves)
    assert dict(nothing.knobs) == {}


def test_it_says_where_the_model_fails_until_only_noise_is_left(bench):
    text = panels.errors_panel(bench.given_state)
    assert "Fails most: torque of" in text
    assert (
        f"against velocity of {bench.given_state.places[0].channel.partition('.')[2]}" in text
    )  # a friction depends on the speed
    before, after = (sum(place.chi2_per_sample for place in bench.refit(e).places) for e in ([], FRICTION))
    assert after < 0.05 * before


def test_the_missing_force_as_ticked_is_flat_when_what_is_hidden_is_ticked(bench):
    def sizes(state):
        """By joint over the speed: as given, and now where that is known."""
        mine = [c for c in bench.missing_force(state) if c.against == "speed"]
        return {c.joint: (np.ptp(c.as_given), None if c.repaired is None else np.ptp(c.repaired)) for c in mine}

    assert all(now is None for _, now in sizes(bench.given_state).values())
    for state in (bench.predict(FRICTION), bench.refit(FRICTION)):
        assert set(sizes(state)) == set(JOINTS)
        assert all(now < 0.2 * given for given, now in sizes(state).values())
    half = {name: 0.5 * knob.parameter.value for name, knob in bench.refit(FRICTION).knobs.items()}
    for given, now in sizes(bench.with_values(FRICTION, half)).values():
        assert now == pytest.approx(0.5 * given, rel=0.2)


def test_the_motion_as_ticked_is_nearer_to_the_recorded_one_when_what_is_hidden_is_ticked(bench):
    def off(effects):
        found = [r for r in bench.motion(effects) if (r.role, r.kind) == ("held_out", "window_0.5")]
        assert {r.joint for r in found} == set(bench.study.model.joints)
        return np.median([np.median(np.abs(r.simulated - r.measured)) for r in found])  # some are carried off

    assert off(labels_of(bench, HIDDEN)) < 0.5 * off(())


def test_turning_a_parameter_predicts_with_it(bench, complains):
    fitted = bench.refit(FRICTION)
    name = f"{HIDDEN}.coefficient[right_s0]"
    value = fitted.knobs[name].parameter.value
    same, off = (bench.with_values(FRICTION, {name: value * factor}) for factor in (1.0, 0.5))
    for a, b in zip(fitted.curves, same.curves, strict=True):
        assert np.allclose(a.residuals[1], b.residuals[1], atol=1e-6)
    assert off.knobs[name].parameter.value == pytest.approx(0.5 * value)
    # Half of a friction is missing on its joint, and on no other.
    for a, b in zip(fitted.curves, off.curves, strict=True):
        changed = np.abs(a.residuals[1] - b.residuals[1]).max()
        assert (changed > a.noise) == (a.channel == "tau.right_s0")
    with complains(UnknownNameError):
        bench.with_values(FRICTION, {"length": 1.0})
    with complains(UnknownNameError):
        bench.predict([f"{HIDDEN}:right_s9"])


def test_a_pendulums_hidden_drag_is_predicted_and_then_fitted():
    rng = np.random.default_rng(3)
    runs = [record(f"{i}.csv", Setup(duration=6.0, hidden={"quadratic_drag": 0.02}), rng) for i in range(2)]
    effects = ("quadratic_drag", "sensor_bias", "string_elasticity")
    bench = Workbench(make_study(base_pendulum(), runs[:1], runs[1:], [CATALOGUE[name] for name in effects]))
    predicted = {name: bench.predict([name]) for name in effects}
    assert min(effects, key=lambda name: error(predicted[name])) == "quadratic_drag"
    assert error(predicted["quadratic_drag"]) < 0.9 * error(bench.given_state)
    fitted = bench.refit(["quadratic_drag"])
    assert not fitted.stale
    assert predicted["quadratic_drag"].stale  # a held-out pendulum has a start of its own to fit
    for kind in (FITTED_RUN, HELD_OUT_RUN):  # what is left is the sensor's noise of 3 mN
        assert error(bench.given_state, kind) > 4e-3
        assert error(fitted, kind) == pytest.approx(3e-3, rel=0.1)
    assert {"length", "mass", "quadratic_drag.coefficient"} <= set(fitted.knobs)


def test_what_is_kept_is_what_add_writes(files, tmp_path, monkeypatch, complains):
    model, run, held_out = files
    inputs = ModelAndRunInputs(model, [run], [held_out], None, None)
    given = inputs.read()
    bench = Workbench(given.study)
    target, report, exported = (tmp_path / f"repaired.{kind}" for kind in ("toml", "html", "json"))
    writable = WritableFileCheck(tmp_path)
    kept = save_model(inputs, given, bench, FRICTION, target, report, exported, writable=writable)
    assert kept.files == (target, report, exported)
    assert HIDDEN in kept.sentence
    assert f"compare {target} {run} --held-out {held_out}" in kept.next_step
    written = read_model_file(target)
    assert [effect.name for effect in written.model.effects] == [HIDDEN]
    assert written.history[-1]["added"] == HIDDEN
    fitted = bench.refit(FRICTION).knobs
    for name, parameter in written.model.parameters.items():
        assert parameter.value == pytest.approx(fitted[name].parameter.value, rel=1e-3)
    with complains(InputError):
        save_model(inputs, given, bench, FRICTION, target, writable=writable)

    # A format without the friction that was found: `armdyn export` refuses it, and so does the page.
    known, exported = exports.format_of_file(tmp_path / "poor.json"), tmp_path / "poor.json"
    poor = known._replace(export=lambda *given: known.export(*given)._replace(held=frozenset()))
    monkeypatch.setattr(exports, "format_of_file", lambda _: poor)
    kept = save_model(inputs, given, bench, FRICTION, target, exported=exported, writable=writable, over=True)
    assert kept.files == (target,)
    assert not exported.exists()
    assert any("is not written" in note and "--incomplete" in note for note in kept.notes)


def test_panels_escape_what_users_name():
    html = panels.files_panel(None, [(Path("<b>.csv"), True)], ["<i>"])
    assert "<b>.csv" not in html
    assert "&lt;i&gt;" in html
    assert panels.short_joint_names(["shoulder_pan_joint", "elbow_joint"])["elbow_joint"] == "elbow"
    assert panels.short_joint_names(["right_s0", "right_w2"])["right_s0"] == "s0"
