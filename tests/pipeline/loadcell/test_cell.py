import itertools
import threading
import time
from datetime import UTC, datetime

import numpy as np
import pytest
import serial
import serial.serialposix

from armdyn.errors import InputError
from pipeline.loadcell.calibration import Calibration
from pipeline.loadcell.cell import LoadCell
from pipeline.loadcell.emulator import EmulatedCell, EmulatedPort
from pipeline.loadcell.faults import Fault
from pipeline.loadcell.protocol import MAXIMUM_COUNTS

CALIBRATION = Calibration(1000.0, 1.0, 1e-4, 1e-8, 4e-3, datetime(2026, 3, 2, tzinfo=UTC), "test")
NEVER = 1e6  # s: silence is of no interest
COUNTS = [2000 + 7 * (k % 11) for k in range(5000)]  # never the same twice in a row


class StoppedClock:
    """A clock that moves only when told, so that no test depends on how busy the machine is."""

    def __init__(self):
        self.now = 50.0

    def __call__(self):
        return self.now


@pytest.fixture
def wire():
    with EmulatedPort() as port:
        yield port


@pytest.fixture
def clock():
    return StoppedClock()


@pytest.fixture
def cell(wire, clock):
    with LoadCell(wire.port, CALIBRATION, clock=clock, silent_after=0.2) as cell:
        yield cell


def began(cell):
    return [event.fault for event in cell.events() if event.began]


def test_forces_arrive_in_order_with_the_time_of_their_reception(wire, clock, cell, until):
    received = []
    for k, counts in enumerate(COUNTS[:50]):
        clock.now = 50.0 + 0.01 * k
        assert wire.send(wire.line(counts), 10.0)
        until(lambda k=k: cell.status().samples == k + 1)
        received += cell.read()
    assert [sample.force for sample in received] == pytest.approx([1e-4 * (c - 1000) for c in COUNTS[:50]])
    assert [sample.time for sample in received] == pytest.approx([50.0 + 0.01 * k for k in range(50)])
    status = cell.status()
    assert status.rate == pytest.approx(100.0)
    assert status.reliable
    assert not any(status.counts.values())


def test_a_cell_at_100_hz_with_every_fault_reports_each_and_keeps_the_good_samples(wire, until):
    """One run on a real pseudo-terminal at 100 Hz; which samples must arrive is known to the last one."""
    counts, expected = iter(COUNTS), []

    def good():
        expected.append(next(counts))
        return [wire.line(expected[-1])]

    def lost():
        wire.line(next(counts))
        return []

    def partial():
        return [wire.line(next(counts))[:11] + b"\n"]

    def repeated():
        line = good()[0]
        return [line, line]

    def crlf():
        return [good()[0][:-1] + b"\r\n"]

    def garbage():
        return [b"\xff\x00\x81 HX711 12 \xfe\n"]

    def noise_before():
        return [b"\x00\xf3\xff" + good()[0]]

    def split():
        line = good()[0]
        return [line[:5], line[5:]]

    def at_end():
        expected.append(MAXIMUM_COUNTS)
        return [wire.line(MAXIMUM_COUNTS)]

    def stuck():
        expected.append(3333)
        return [wire.line(3333)]

    good_ones = itertools.repeat(good, 20)
    script = [*good_ones, lost, lost, good, partial, good, repeated, crlf, crlf, good, garbage, good, noise_before]
    script += [*itertools.repeat(split, 5), at_end, *itertools.repeat(good, 5), *itertools.repeat(stuck, 100)]
    script += itertools.repeat(good, 40)
    with LoadCell(wire.port, CALIBRATION, silent_after=NEVER) as cell:
        begin, received = time.monotonic(), []
        for k, step in enumerate(script):
            time.sleep(max(0.0, begin + 0.01 * k - time.monotonic()))
            for piece in step():
                assert wire.send(piece, 10.0)
            received += cell.read()
        until(lambda: cell.status().samples == len(expected))
        assert cell.status().reliable
        assert cell.status().rate > 0
        wire.close()
        until(lambda: not cell.status().connected)
        received += cell.read()
        status, events = cell.status(), cell.events()
    assert [sample.force for sample in received] == pytest.approx([CALIBRATION.force(c) for c in expected])
    assert np.all(np.diff([sample.time for sample in received]) > 0)
    assert {fault.name: count for fault, count in status.counts.items() if count} == {
        "DISCONNECTED": 1,
        "SATURATED": 1,
        "FROZEN": 1,
        "MALFORMED": 3,
        "DROPPED": 3,  # two, and the one whose line was torn
        "REPEATED": 1,
    }
    assert status.active == (Fault.DISCONNECTED,)
    assert not status.reliable
    lasting = [(event.fault, event.began) for event in events if event.fault.lasts]
    assert lasting == [
        (Fault.SATURATED, True),
        (Fault.SATURATED, False),
        (Fault.FROZEN, True),
        (Fault.FROZEN, False),
        (Fault.DISCONNECTED, True),
    ]


def test_silence_is_noticed_without_a_sample_and_ends_with_one(wire, clock, cell, until):
    wire.send(wire.line(2000), 10.0)
    until(lambda: cell.status().samples == 1)
    assert cell.status().reliable
    clock.now += 0.21
    assert cell.status().active == (Fault.SILENT,)
    assert cell.status().rate == 0.0
    assert cell.status().connected
    wire.send(wire.line(2001), 10.0)
    until(lambda: cell.status().reliable)
    assert began(cell) == [Fault.SILENT]


def test_a_board_that_restarts_when_opened_has_time_to_do_so(clock, cell):
    clock.now += 4.0
    assert cell.status().active == ()
    assert not cell.status().reliable
    clock.now += 2.0
    assert cell.status().active == (Fault.SILENT,)


def test_an_unplugged_cell_is_noticed_and_its_last_samples_can_be_read(wire, cell, until):
    for counts in COUNTS[:5]:
        wire.send(wire.line(counts), 10.0)
    until(lambda: cell.status().samples == 5)
    wire.close()
    until(lambda: began(cell) == [Fault.DISCONNECTED])
    assert len(cell.read()) == 5
    assert cell.read() == []
    assert not cell.status().connected
    assert cell.status().active == (Fault.DISCONNECTED,)


def test_a_reader_that_does_not_read_loses_the_oldest_samples_and_is_told_once(wire, clock, until):
    with LoadCell(wire.port, CALIBRATION, clock=clock, queue=10) as cell:
        for counts in COUNTS[:50]:
            assert wire.send(wire.line(counts), 10.0)
        until(lambda: cell.status().samples == 50)
        assert [s.force for s in cell.read()] == pytest.approx([CALIBRATION.force(c) for c in COUNTS[40:50]])
        assert cell.status().counts[Fault.OVERFLOW] == 40
        assert began(cell) == [Fault.OVERFLOW]


def test_a_flood_of_noise_does_not_pile_up(wire, cell, until):
    noise = bytes(range(1, 256)) * 4
    for _ in range(300):
        assert wire.send(noise, 10.0)
    assert wire.send(b"\n" + wire.line(2000), 10.0)
    until(lambda: cell.status().samples == 1)
    assert cell.status().counts[Fault.MALFORMED] > 100
    assert len(cell.events()) <= 1000


def test_closing_ends_the_thread_and_frees_the_port(wire):
    before = threading.active_count()
    for _ in range(5):
        cell = LoadCell(wire.port, CALIBRATION)
        assert threading.active_count() == before + 1
        cell.close()
        cell.close()
        assert threading.active_count() == before
    assert not cell.status().connected
    assert Fault.DISCONNECTED not in cell.status().active


def test_closing_after_the_cable_was_pulled_is_clean(wire, until):
    cell = LoadCell(wire.port, CALIBRATION)
    wire.close()
    until(lambda: not cell.status().connected)
    cell.close()
    assert not [thread for thread in threading.enumerate() if thread.name == "load cell"]


def test_an_error_while_reading_does_not_leave_the_thread_behind(wire):
    with pytest.raises(RuntimeError, match="elsewhere"), LoadCell(wire.port, CALIBRATION):
        raise RuntimeError("elsewhere")
    assert not [thread for thread in threading.enumerate() if thread.name == "load cell"]


def test_a_port_in_use_is_said_to_be_in_use(wire):
    with LoadCell(wire.port, CALIBRATION), pytest.raises(InputError, match="another program has it open"):
        LoadCell(wire.port, CALIBRATION)


def test_a_missing_port_names_those_that_are_present(monkeypatch):
    from serial.tools import list_ports
    from serial.tools.list_ports_common import ListPortInfo

    monkeypatch.setattr(list_ports, "comports", lambda: [ListPortInfo("/dev/ttyACM7"), ListPortInfo("/dev/ttyACM1")])
    with pytest.raises(InputError, match=r"^/dev/ttyNONE: there is no such port: choose one of .*ACM1, .*ACM7$"):
        LoadCell("/dev/ttyNONE", CALIBRATION)


def test_without_any_port_the_emulated_cell_is_offered(monkeypatch):
    from serial.tools import list_ports

    monkeypatch.setattr(list_ports, "comports", list)
    with pytest.raises(InputError, match=r"none is present.*'emulated'"):
        LoadCell("/dev/ttyNONE", CALIBRATION)


def test_a_forbidden_port_says_which_group_to_join(wire, monkeypatch):
    def forbidden(*_):
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(serial.serialposix.os, "open", forbidden)
        with pytest.raises(InputError, match=r"permission denied: 'sudo usermod -aG \w+ \$USER', then log in again$"):
            LoadCell(wire.port, CALIBRATION)


def test_a_file_is_not_taken_for_a_port(tmp_path):
    (tmp_path / "file").write_text("HX711 0 0\n")
    with pytest.raises(InputError, match="is not a serial port"):
        LoadCell(str(tmp_path / "file"), CALIBRATION)


def test_an_emulated_cell_measures_what_hangs_on_it(until):
    with EmulatedCell(np.random.default_rng(3), 0.785, rate=200.0) as source:
        noise = source.noise * source.scale
        calibration = Calibration(source.offset, 0.0, source.scale, 0.0, noise, datetime(2026, 3, 2, tzinfo=UTC), "")
        with LoadCell(source.port, calibration, silent_after=NEVER) as cell:
            until(lambda: cell.status().samples >= 100)
            forces = np.array([sample.force for sample in cell.read()])
            source.close()
            until(lambda: cell.status().active == (Fault.DISCONNECTED,))
    assert forces.mean() == pytest.approx(0.785, abs=5 * noise / np.sqrt(len(forces)))
    assert forces.std() == pytest.approx(noise, rel=0.4)
