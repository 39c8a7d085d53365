"""The page in a real browser, with real clicks."""

import signal
from contextlib import contextmanager

import numpy as np
import pytest
from browser import SIXTY, Browser, chromium
from worlds.laws import world
from worlds.pendulum import Setup, record

from armdyn.effects.user import load_effects
from armdyn.model_file import ModelFile, base_pendulum, write_model_file
from armdyn.run import write_run_csv

from .conftest import HIDDEN, RIVALS, workbench

ERROR = "Number(document.querySelector('.key').dataset.value)"
NONE = "!document.querySelector('[data-pick]:checked')"
FITTED = "document.querySelector('.how.fitted')"
READY = "document.querySelector('[data-pick]') && document.body.dataset.ready"
POINT = """(() => {
    const point = document.querySelector("#missing .point:nth-child(9)");
    point.scrollIntoView({ block: "center", behavior: "instant" });
    const { x, y, width, height } = point.getBoundingClientRect();
    return [x + width / 2, y + height / 2];
})()"""
TURNED = """(() => {
    const knob = document.querySelector("[data-knob=length]");
    knob.value = knob.value / 2;
    knob.dispatchEvent(new Event("input", { bubbles: true }));
})()"""


@contextmanager
def served(folder, *arguments):
    """The address of a workbench; it must end in order on Ctrl-C."""
    chromium()
    with workbench(folder, *arguments) as (process, address):
        yield address.geturl()
        process.send_signal(signal.SIGINT)
        out, errors = process.communicate(timeout=20)
        assert (process.returncode, out, errors) == (0, "workbench closed\n", "")


@pytest.fixture(scope="module")
def address(files, tmp_path_factory):
    model, run, held_out = files
    with served(tmp_path_factory.mktemp("work"), model, run, "--held-out", held_out) as found:
        yield found


@pytest.fixture
def browser(address):
    with Browser() as tab:
        tab.go(address)
        tab.wait(READY)
        yield tab
        assert tab.errors == []


def ticked(browser, selector):
    """Click, and the error that the page shows when the refit is done."""
    n = browser.ask("armdynBench.latencies.length")
    browser.click(selector)
    browser.wait(f"armdynBench.latencies.length > {n}")
    browser.wait(FITTED)
    return browser.ask(ERROR)


def test_a_hidden_effect_is_found_by_clicking(browser):
    given, left = browser.ask(ERROR), {}
    for effect in (HIDDEN, *RIVALS):
        every = browser.ask(f"Boolean(document.querySelector(\"[data-every='{effect}']\"))")
        left[effect] = ticked(browser, f"[data-every='{effect}']" if every else f"[data-pick^='{effect}'] + span")
        browser.click("#clear")
        browser.wait(f"{NONE} && {ERROR} == {given}")
    assert min(left, key=left.get) == HIDDEN
    assert left[HIDDEN] < 0.2 * given

    ticked(browser, f"[data-every='{HIDDEN}']")
    browser.wait("document.querySelector('#missing').innerText.includes('as ticked')")
    browser.click("#curves [data-tab='tau.right_e1'] + span")
    browser.wait("document.querySelector('#law').innerText.includes('of right_e1 grows in proportion to the speed')")
    readout = "document.querySelector('#curves .readout').innerText"
    browser.wait(f"{readout}.startsWith('torque of right_e1')")
    assert "as given" in browser.ask(readout)
    browser.click("#show-scene")
    browser.wait("document.getElementById('scene').dataset.ready")
    assert browser.ask("document.querySelector('#scene canvas').width") > 300
    browser.ask("document.querySelector('#scene input').dispatchEvent(new Event('input', { bubbles: true }))")
    browser.wait("document.querySelector('.cursor').isConnected")


@pytest.mark.slow
def test_a_search_ranks_it_and_what_is_kept_is_a_model_file(browser):
    browser.click("#search")
    browser.wait("document.querySelector('[data-try]')")
    assert browser.ask("document.querySelector('[data-try]').dataset.try").startswith(HIDDEN)
    ticked(browser, "[data-try]")
    browser.click("#keep")
    browser.wait("document.querySelector('#go-on')")
    assert "repaired.toml" in browser.ask("document.querySelector('#kept').innerText")
    browser.click("#keep")
    browser.wait("document.querySelector('#said').innerText.includes('is there already')")


@pytest.mark.slow
def test_a_click_on_the_missing_force_proposes_a_law_and_adds_it(tmp_path):
    """What is kept then has the law's file beside it, and the next command names it."""
    given, noise = world("cubic drag", 3), 1e-3  # rad
    write_model_file(tmp_path / "m.toml", ModelFile(base_pendulum({"mass": f"{given.mass} kg"}), {}))
    for run, name in zip((given.runs[0], given.held_out), ("a.csv", "b.csv"), strict=True):
        write_run_csv(run, tmp_path / name)
    with served(tmp_path, "m.toml", "a.csv", "--held-out", "b.csv") as found, Browser() as browser:
        browser.go(found)
        browser.wait(READY)
        browser.wait("document.querySelector('#missing .point')")
        before = browser.ask(ERROR)
        browser.point(*browser.ask(POINT))
        browser.wait("document.querySelector('#missing .hovertext')")
        browser.click("#missing .point:nth-child(9)")
        browser.wait("document.querySelector('#proposal').innerText.includes('k * speed^3')", 5 * SIXTY)
        browser.wait(f"document.querySelector('[data-pick=discovered_cubic_drag]:checked') && {FITTED}")
        assert browser.ask(ERROR) < min(1.3 * noise, 0.2 * before)
        browser.wait("document.querySelector('#missing').innerText.includes('what that explains')")
        browser.click("#keep")
        browser.wait("document.querySelector('#go-on')")
        assert "--effects repaired_effects.py" in browser.ask("document.querySelector('#kept').innerText")
        assert [effect.name for effect in load_effects(tmp_path / "repaired_effects.py")] == ["discovered_cubic_drag"]
        assert browser.errors == []


@pytest.mark.slow
def test_each_tab_has_a_choice_of_its_own(address, browser):
    ticked(browser, "[data-pick='torque_offset:right_s0'] + span")
    count = "document.querySelectorAll('[data-pick]:checked').length"
    with Browser() as other:
        other.go(address)
        other.wait(READY)
        assert other.ask(count) == 0
    assert browser.ask(count) == 1


@pytest.mark.slow
def test_a_pendulum_is_started_and_its_recording_dropped_on_a_small_dark_screen(tmp_path):
    run = record("swing.csv", Setup(duration=5.0, hidden={"quadratic_drag": 0.02}), np.random.default_rng(3))
    write_run_csv(run, tmp_path / "swing.csv")
    (tmp_path / "broken.csv").write_text("time [s],load_force [bananas]\n0,1\n")
    with served(tmp_path) as found, Browser(400, 800, dark=True) as browser:
        browser.go(found)
        browser.wait("document.querySelector('#subtitle').innerText.includes('still needed')")
        browser.click("#start-pendulum")
        browser.wait("document.querySelector('#files').innerText.includes('pendulum.toml')")
        browser.drop("input[type=file]", [tmp_path / "broken.csv"])
        browser.wait("document.querySelector('#said').innerText.includes('bananas')")
        browser.drop("input[type=file]", [tmp_path / "swing.csv"])
        browser.wait("document.querySelector('[data-pick]')")
        assert browser.ask(ERROR) > 3.5e-3
        assert ticked(browser, "[data-pick='quadratic_drag'] + span") == pytest.approx(3e-3, rel=0.1)  # N, the noise
        browser.ask(TURNED)
        browser.wait(f"document.querySelector('.how.by-hand') && {ERROR} > 4e-3")  # the prediction with half the length
        browser.click("#refit")
        browser.wait(f"{FITTED} && {ERROR} < 3.5e-3")
        assert browser.ask("document.documentElement.scrollWidth") <= 400  # nothing scrolls sideways
        assert browser.errors == []
