"""A swing misses for a hidden effect; the recording of that trial says why; the next swing lands."""

from pathlib import Path

import pytest

from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.user import load_effects
from armdyn.identify.repair import add, repair
from armdyn.identify.studies import make_study
from armdyn.model_file import read_model
from armdyn.run import read_run
from pipeline.trial import TrialSettings, run_trial, simulate_trial

EXAMPLES = Path(__file__).parents[3] / "examples"
RIVALS = ("quadratic_drag", "wind", "string_creep", "pivot_viscous_friction", "sensor_gain", "gripper_lag")
KNOWN = {"linear_drag", "sensor_bias", "sensor_delay"}
"""Effects that every estimate allows for."""


def repaired_after(hidden, out, seed=0):
    """The trial that does not know, and the repair of the model that it had."""
    unaware = simulate_trial(TrialSettings(hidden=hidden, seed=seed, out=out))
    found = repair(
        make_study(
            read_model(out / "model.toml"), [read_run(out / "trial.csv")], [], [CATALOGUE[name] for name in RIVALS]
        )
    )
    return unaware, found


def added(found):
    return {effect.name for effect in found.model.effects} - KNOWN


def aware(hidden, found):
    """The settings of the trial with what was found."""
    return TrialSettings(hidden=hidden, model=found.model, length_guess=found.model.value("length"))


# Without the effect the load is 0.18 m off with drag and 0.24 m with creep, with it 0.03 m at most, on every seed.
# The value is found to 2 % and 5 %.
@pytest.mark.parametrize(
    ("effect", "parameter", "size"),
    [
        pytest.param("quadratic_drag", "coefficient", 0.05, marks=pytest.mark.slow),
        pytest.param("string_creep", "rate", 1e-3, marks=pytest.mark.slow),
    ],
)
def test_what_is_repaired_lands(effect, parameter, size, tmp_path, off_target):
    hidden = {effect: size}
    unaware, found = repaired_after(hidden, tmp_path)
    assert off_target(unaware) > 0.12
    assert added(found) == {effect}
    assert found.model.value(f"{effect}.{parameter}") == pytest.approx(size, rel=0.15)
    assert found.path[-1].chi2_per_sample < 0.6 * found.path[0].chi2_per_sample
    trial = simulate_trial(aware(hidden, found))
    assert trial.result.success
    assert off_target(trial) < 0.04


@pytest.mark.slow
def test_wind_that_is_repaired_leaves_the_length_right(tmp_path):
    # Whether a swing in wind lands hangs on the last bit, the length does not: wind makes it 12 mm too short.
    hidden = {"wind": 0.2}
    unaware, found = repaired_after(hidden, tmp_path)
    assert unaware.experiment.estimator.model.value("length") < 0.368 - 6e-3
    assert added(found) == {"wind"}
    assert found.model.value("wind.force") == pytest.approx(0.2, rel=0.05)
    assert found.path[-1].chi2_per_sample < 0.4 * found.path[0].chi2_per_sample
    assert run_trial(aware(hidden, found)).length_estimate == pytest.approx(0.368, abs=2e-3)


def test_the_model_of_a_trial_is_the_one_that_it_estimated_with(learnt):
    kept = read_model(learnt.result.recording.parent / "model.toml")
    assert kept.value("length") == pytest.approx(learnt.result.length_estimate, abs=1e-12)
    assert {e.name for e in kept.effects} == KNOWN
    prior = kept.parameters["sensor_delay.time"].prior
    assert (prior.mean, prior.std) == (0.01, 0.01)
    assert kept.parameters["initial_angle"].fitted


def test_a_load_cell_decides_against_the_printed_tension(learnt):
    folder = learnt.result.recording.parent
    (printed,) = load_effects(EXAMPLES / "printed_tension.py")
    study = make_study(read_model(folder / "model.toml"), [read_run(folder / "trial.csv")], [], [printed])
    share = add(study, [printed]).model.parameters["printed_tension.share"]
    assert share.value == pytest.approx(0.0, abs=5 * share.std)
    assert share.std < 0.01
