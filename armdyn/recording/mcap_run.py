"""Read recordings in MCAP files, as the pipeline writes them and Foxglove and PlotJuggler show them.

One topic per group of channels (``/gripper``, ``/load``, ``/q``, ...) holds JSON messages ``{"time": 0.01, "x": 0.2}``.
The metadata of each topic gives the channel and unit of a field: ``{"x": "gripper_x [m]"}``. The text of the sidecar is
the metadata record ``armdyn.sidecar``. Topics without such metadata are ignored: a file may contain more.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from armdyn.errors import InputError, error_location
from armdyn.recording.bytes_in import read_bytes
from armdyn.recording.channels import Channel, SampleError, is_channel_name, name_and_unit, unit_conversion
from armdyn.recording.mcap_records import intact_records
from armdyn.recording.sidecar import Sidecar, parse_sidecar

SIDECAR_RECORD = "armdyn.sidecar"
TIME_FIELD = "time"


def topic_and_field(channel: str) -> tuple[str, str]:
    """Topic and field of a channel: ``gripper_x`` is field ``x`` of ``/gripper``, ``q.right_s1`` one of ``/q``."""
    separator = "." if "." in channel else "_"
    group, _, field = channel.partition(separator)
    return f"/{group}", field or "value"


@dataclass(frozen=True)
class McapRecording:
    """Content of one MCAP file.

    Attributes:
        channels: all recorded channels, by name.
        sidecar: known facts on the recording besides its samples.
        warnings: a sentence on lost samples; empty for a complete file.
    """

    channels: dict[str, Channel]
    sidecar: Sidecar
    warnings: tuple[str, ...] = ()


@dataclass
class _Samples:
    unit: str
    time: list[float] = field(default_factory=list)
    value: list[float] = field(default_factory=list)


ROS_ENCODINGS = ("cdr", "ros1")
"""Encodings of the messages of a bag of ROS 2 and ROS 1."""


def read_mcap(path: Path, recover: bool = False) -> McapRecording:
    """Read a recording from an MCAP file.

    Args:
        path: the file.
        recover: read as much as possible of a file that was cut off or damaged, with a warning in `warnings`.

    Raises:
        InputError: the file cannot be read, is cut off or damaged (unless `recover`), or contains no channels of
            armdyn.
    """
    data = _bytes(path)
    with error_location(path):
        samples, sidecar, problem = _scan(data, path)
    recorded = {name: one for name, one in samples.items() if one.time}
    warnings: tuple[str, ...] = ()
    if problem and not recover:
        raise InputError(
            f"{path}: {problem}: copy it again, or recover what is there with read_run(path, recover=True)"
        )
    if problem and not recorded:
        raise InputError(f"{path}: {problem}, before the first sample could be read: copy it again")
    if problem:
        last = max(one.time[-1] for one in recorded.values())
        warnings = (f"{path.name} {problem}; recovered up to {last:.3f} s",)
    if not recorded:
        raise InputError(f"{path}: holds no samples of armdyn: give a recording made by 'armdyn trial', or a CSV")
    channels = {}
    for name, one in recorded.items():
        with error_location(f"{path}: channel '{name}'"):
            channels[name] = _channel(name, one)
    return McapRecording(channels, sidecar, warnings)


def _bytes(path: Path) -> bytes:
    data = read_bytes(path)
    if not data:
        raise InputError(f"{path}: is empty: record again or give another file")
    if not data.startswith(b"\x89MCAP0\r\n"[: len(data)]):
        raise InputError(f"{path}: is not an MCAP file: give one, or a CSV that ends in .csv")
    return data


def _scan(data: bytes, path: Path) -> tuple[dict[str, _Samples], Sidecar, str]:
    """Samples and sidecar of a file, as far as it can be read, and the reason why reading stopped, empty at its end."""
    from mcap.records import Channel as Topic
    from mcap.records import Message, Metadata

    samples, sidecar, problems = dict[str, _Samples](), Sidecar(), list[str]()
    labels: dict[int, dict[str, tuple[str, str]]] = {}
    try:
        for record in intact_records(data, problems):
            if isinstance(record, Topic):
                if record.message_encoding in ROS_ENCODINGS:
                    raise InputError(f"is a ROS bag and no run: type 'armdyn import {path} --output runs' first")
                labels[record.id] = {
                    key: name_and_unit(label) for key, label in record.metadata.items() if label.endswith("]")
                }
                for name, unit in labels[record.id].values():
                    samples.setdefault(name, _Samples(unit))
            elif isinstance(record, Message) and labels.get(record.channel_id):
                _take(json.loads(record.data), labels[record.channel_id], samples)
            elif isinstance(record, Metadata) and record.name == SIDECAR_RECORD:
                sidecar = parse_sidecar(record.metadata["toml"])
    except InputError:
        raise
    except Exception as error:  # the content of a record is damaged
        problems.append(f"is damaged ({type(error).__name__})")
    return samples, sidecar, ", and ".join(dict.fromkeys(problems))


def _take(message: dict[str, float], labels: dict[str, tuple[str, str]], samples: dict[str, _Samples]) -> None:
    time = float(message[TIME_FIELD])
    for name_in_topic, value in message.items():
        if name_in_topic in labels:
            channel = samples[labels[name_in_topic][0]]
            channel.time.append(time)
            channel.value.append(float(value))


def _channel(name: str, samples: _Samples) -> Channel:
    time, value = np.array(samples.time), np.array(samples.value)
    if not is_channel_name(name):
        return Channel(time, value, samples.unit)  # a further quantity, in its own unit
    to_si = unit_conversion(name, samples.unit)
    try:
        return Channel(time, to_si(value), to_si.unit)
    except SampleError as error:
        raise InputError(f"at {time[error.index]:.3f} s: {error.fault}") from error
