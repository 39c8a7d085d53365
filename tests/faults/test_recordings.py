"""Recordings that are well formed and still of no use: one line, status 2, bounded time and memory."""

import resource
import struct

import numpy as np
import pytest
import zstandard

from armdyn.errors import InputError
from armdyn.recording.mcap_run import read_mcap
from armdyn.recording.units import parse_quantity, si_factor
from armdyn.run import read_run

TIME = np.arange(300) / 100
RNG = np.random.default_rng(0)
X = 0.05 * np.sin(3 * TIME)
FORCE = 0.8 + 0.01 * np.sin(5 * TIME) + 1e-3 * RNG.normal(size=TIME.size)


def table(time=TIME, x=X, force=FORCE):
    rows = (f"{float(t)!r},{float(a)!r},{float(f)!r}" for t, a, f in zip(time, x, force, strict=True))
    return "\n".join(["time [s],gripper_x [m],load_force [N]", *rows]) + "\n"


@pytest.fixture
def compare(armdyn, tmp_path):
    def run(text, sidecar="", *, command="compare", more=()):
        (tmp_path / "m.toml").write_text('base = "pendulum"\neffects = []\n')
        (tmp_path / "a.csv").write_text(text)
        (tmp_path / "a.toml").write_text(sidecar)
        status, _, err = armdyn(command, "m.toml", *more, "a.csv")
        return status, err

    return run


def jumped(at, by):
    return TIME + np.where(np.arange(TIME.size) >= at, by, 0.0)


def spiked(values, at, value):
    changed = values.copy()
    changed[at] = value
    return changed


BAD = {
    "milliseconds as seconds": (table(1000 * TIME), ""),
    "microseconds as seconds": (table(1e6 * TIME), ""),
    "clock jumps": (table(jumped(150, 1e6)), ""),
    "clock jumps far": (table(jumped(150, 1.7e9)), ""),
    "nanosecond steps": (table(1e-9 * np.arange(300)), ""),
    "one nanosecond step": (table(spiked(TIME, 100, TIME[99] + 1e-9)), ""),
    "gripper far away once": (table(x=spiked(X, 100, 900.0)), ""),
    "encoder of 1000 rad once": (table(x=spiked(X, 100, 1000.0)).replace("gripper_x [m]", "swing_angle [rad]"), ""),
    "known effect that the model lacks": (
        table(),
        '[known]\n"quadratic_drag.coefficient" = "0.3 N s^2/m^2 +/- 0.1 N s^2/m^2"\n',
    ),
    "misspelt known": (table(), '[known]\nlenght = "0.3 m"\n'),
    "known in a wrong unit": (table(), '[known]\ninitial_angle = "3 kg"\n'),
    "misspelt table": (table(), '[knwon]\nmass = "80 g"\n'),
    "misspelt noise": (table(), '[nosie]\nload_force = "3 mN"\n'),
    "known outside its table": (table(), 'mass = "80 g"\n'),
    "endless unit": (table().replace("[N]", "[N**9**9**9**9]"), ""),
    "nested sidecar": (table(), "known = " + "[" * 5000 + "]" * 5000),
    "endless number": (table(), "known = " + "9" * 5000),
}


@pytest.mark.parametrize(("text", "sidecar"), BAD.values(), ids=BAD)
def test_a_useless_recording_is_one_line_and_status_two(compare, text, sidecar, complains):
    status, err = compare(text, sidecar)
    assert status == 2, err
    complains.line(err)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 2 * 2**20  # kB


def test_what_is_known_of_an_effect_that_is_being_added_is_used(compare):
    known = '[known]\n"linear_drag.coefficient" = "5e-3 N s/m +/- 1e-3 N s/m"\n'
    assert compare(table(), known)[0] == 2
    status, err = compare(table(), known, command="add", more=("linear_drag",))
    assert status == 0, err


@pytest.mark.parametrize(
    "unit",
    [
        "N**9**9**9**9", "((9**9)**9)**9", "9⁹⁹⁹⁹⁹⁹", "N^99999999", "9⁹**9", "9** 9 **9**9", "N" * 5000, "(" * 60,
        "m^1e9",
    ],
)  # fmt: skip
def test_an_endless_unit_is_refused_at_once(unit):
    with pytest.raises(InputError) as error:
        si_factor(unit, "N")
    assert len(str(error.value)) < 250


def test_a_value_that_overflows_in_si_is_refused(complains):
    with complains(InputError):
        parse_quantity("1e308 km")


def chunk(payload, compression, stated):
    body = struct.pack("<QQQI", 0, 0, stated, 0) + struct.pack("<I", len(compression)) + compression
    body += struct.pack("<Q", len(payload)) + payload
    return b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, len(body)) + body


def bombs():
    import lz4.frame

    squeezer = zstandard.ZstdCompressor().compressobj()
    piece = b"\0" * 2**20
    squeezed = b"".join(squeezer.compress(piece) for _ in range(100)) + squeezer.flush()
    packer = lz4.frame.LZ4FrameCompressor()
    packed = packer.begin() + b"".join(packer.compress(piece) for _ in range(100)) + packer.flush()
    return {
        "zstd, stated": chunk(squeezed, b"zstd", 2**40),
        "zstd, hidden": chunk(squeezed, b"zstd", 1000),
        "lz4, stated": chunk(packed, b"lz4", 2**40),
        "lz4, hidden": chunk(packed, b"lz4", 1000),
        "many": chunk(squeezed, b"zstd", 2**26 - 1) + b"".join(chunk(b"", b"zstd", 2**26)[8:] for _ in range(9)),
    }


@pytest.mark.parametrize("kind", ["zstd, stated", "zstd, hidden", "lz4, stated", "lz4, hidden", "many"])
@pytest.mark.parametrize("recover", [False, True])
def test_a_compressed_bomb_is_refused_before_it_is_expanded(tmp_path, kind, recover, complains):
    path = tmp_path / "a.mcap"
    path.write_bytes(bombs()[kind])
    with complains(InputError):
        read_mcap(path, recover)


def test_an_endless_device_is_refused(complains):
    from pathlib import Path

    with complains(InputError):
        read_run(Path("/dev/zero"))
