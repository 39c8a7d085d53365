"""Spoils text and bytes as people, programs and disks do; every spoiled file follows from a seed."""

import random
import re
from collections.abc import Callable

NUMBERS = (
    "nan", "-nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "1e400", "0", "-0.0", "-1", "1e9", "1e-9", "3", "0.5",
    "-2", "12.7", "1000", "1e-3", "0.01", "30", "9" * 20, "9" * 400, "0x10", "1_000", "1,5", "٣", "1e", "--1", "", " ",
    "true", '"1"', "[]", "{}", "null",
)  # fmt: skip
WORDS = (
    "\0", "\r", "\n", "\t", "\ufeff", "\u202e", "é", "😀", "'", '"', '"""', "[", "]", "[[", "{", "}", "(", ")", "=",
    ",", ";", "#", "\\", "/", "../", "%s", "<", ">", "&", "&amp;", "N**9**9", "m/s", "kg", "universe", "None",
    "lambda: 0", "+/-", "±", "%", "[" * 300, "{a=" * 100, "(" * 300, "a" * 5000, "<a>" * 300,
)  # fmt: skip
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_WORD = re.compile(r"\w+")


def spoiled_text(text: str, rng: random.Random) -> str:
    """The text with one to four mistakes."""
    for _ in range(rng.choice((1, 1, 1, 1, 2, 4))):
        text = rng.choice(_OF_TEXT)(text, rng)
    return text


def spoiled_bytes(data: bytes, rng: random.Random) -> bytes:
    """The bytes with one to four mistakes."""
    for _ in range(rng.choice((1, 1, 1, 1, 2, 4))):
        data = rng.choice(_OF_BYTES)(data, rng)
    return data


def encoded(text: str, rng: random.Random) -> bytes:
    """The text as bytes, mostly as UTF-8."""
    how = rng.choices(("utf-8", "latin-1", "utf-16", "utf-8-sig"), (40, 1, 1, 1))[0]
    return text.encode(how, errors="replace")


def _replace(pattern: re.Pattern[str], words: tuple[str, ...]) -> Callable[[str, random.Random], str]:
    def spoil(text: str, rng: random.Random) -> str:
        found = list(pattern.finditer(text))
        if not found:
            return text + rng.choice(words)
        one = rng.choice(found)
        return text[: one.start()] + rng.choice(words) + text[one.end() :]

    return spoil


def _exchange(text: str, rng: random.Random) -> str:
    """Two words of the file change places."""
    found = list(_WORD.finditer(text))
    if len(found) < 2:
        return text
    first, second = sorted(rng.sample(range(len(found)), 2))
    a, b = found[first], found[second]
    return text[: a.start()] + b.group() + text[a.end() : b.start()] + a.group() + text[b.end() :]


def _misspell(text: str, rng: random.Random) -> str:
    found = [one for one in _WORD.finditer(text) if len(one.group()) > 3 and not one.group()[0].isdigit()]
    if not found:
        return text
    one = rng.choice(found)
    at = rng.randrange(one.start(), one.end() - 1)
    return text[:at] + text[at + 1] + text[at] + text[at + 2 :]


def _insert(text: str, rng: random.Random) -> str:
    at = rng.randrange(len(text) + 1)
    return text[:at] + rng.choice(WORDS) + text[at:]


def _delete(text: str, rng: random.Random) -> str:
    at = rng.randrange(len(text) + 1)
    return text[:at] + text[at + rng.choice((1, 3, 20, 200)) :]


def _cut(text: str, rng: random.Random) -> str:
    return text[: rng.randrange(len(text) + 1)]


def _lines(text: str, rng: random.Random) -> str:
    lines = text.split("\n")
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    what = rng.randrange(5)
    if what == 0:
        del lines[a]
    elif what == 1:
        lines.insert(a, lines[b])
    elif what == 2:
        lines[a], lines[b] = lines[b], lines[a]
    elif what == 3:
        lines[a:a] = [lines[b]] * 300
    else:
        lines.reverse()
    return "\n".join(lines)


def _separators(text: str, rng: random.Random) -> str:
    old, new = rng.choice(((",", ";"), (".", ","), ("\n", "\r"), ("\n", "\r\n"), (" ", "\t"), ('"', "'"), ("=", ":")))
    return text.replace(old, new)


def _flip(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 8, 64)) if changed else 0):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _extreme(data: bytes, rng: random.Random) -> bytes:
    """A length, count or offset that is as large as can be, or nothing."""
    width = rng.choice((1, 2, 4, 8))
    at = rng.randrange(max(1, len(data) - width))
    value = rng.choice((0, 1, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1, 255)) & (2 ** (8 * width) - 1)
    return data[:at] + value.to_bytes(width, "little") + data[at + width :]


def _splice(data: bytes, rng: random.Random) -> bytes:
    a, b = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    at = rng.randrange(len(data) + 1)
    return data[:at] + data[a:b] + data[at:]


def _lose(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + data[at + rng.choice((1, 8, 100, 4096)) :]


def _end(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _zeros(data: bytes, rng: random.Random) -> bytes:
    at, count = rng.randrange(len(data) + 1), rng.choice((8, 512, 4096))
    return data[:at] + bytes(min(count, len(data) - at)) + data[at + count :]


_OF_TEXT: tuple[Callable[[str, random.Random], str], ...] = (
    _replace(_NUMBER, NUMBERS), _replace(_NUMBER, NUMBERS), _replace(_NUMBER, NUMBERS), _replace(_WORD, WORDS),
    _replace(_WORD, NUMBERS), _exchange, _exchange, _misspell, _insert, _insert, _delete, _cut, _lines, _separators,
)  # fmt: skip
_OF_BYTES: tuple[Callable[[bytes, random.Random], bytes], ...] = (_flip, _flip, _extreme, _splice, _lose, _end, _zeros)
