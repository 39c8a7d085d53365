"""Files as people, programs and disks spoil them, as strategies of hypothesis: a failure shrinks to one mistake."""

import re

from hypothesis import strategies as st

NUMBERS = (
    "nan", "-nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "1e-300", "1e400", "1e290", "0", "-0.0", "-1", "1e9",
    "1e-9", "3", "0.5", "-2", "12.7", "1000", "1e-3", "0.01", "30", "9" * 20, "9" * 400, "0x10", "1_000", "1,5", "٣",
    "1e", "--1", "", " ", "true", '"1"', "[]", "{}", "null",
)  # fmt: skip
WORDS = (
    "\0", "\r", "\n", "\t", "\ufeff", "\u202e", "é", "😀", "'", '"', '"""', "*/", "</script>", "[", "]", "[[", "{", "}",
    "(", ")", "=", ",", ";", "#", "\\", "/", "../", "%s", "<", ">", "&", "&amp;", "N**9**9", "m/s", "kg", "universe",
    "None", "lambda: 0", "sys.exit()", "+/-", "±", "%", "[" * 300, "{a=" * 100, "(" * 300, "a" * 5000, "<a>" * 300,
)  # fmt: skip
EXCHANGED = ((",", ";"), (".", ","), ("\n", "\r"), ("\n", "\r\n"), (" ", "\t"), ('"', "'"), ("=", ":"))
LOST = (1, 3, 20, 200, 4096)
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_WORD = re.compile(r"\w+")


@st.composite
def spoiled_text(draw, good):
    """A good text with one to four mistakes."""
    text = draw(good)
    for _ in range(draw(st.sampled_from((1, 1, 1, 2, 4)))):
        text = draw(draw(st.sampled_from(_OF_TEXT))(text))
    return text


@st.composite
def spoiled_bytes(draw, good):
    """Good bytes with one to four mistakes."""
    data = draw(good)
    for _ in range(draw(st.sampled_from((1, 1, 1, 2, 4)))):
        data = draw(draw(st.sampled_from(_OF_BYTES))(data))
    return data


@st.composite
def encoded(draw, text):
    """A text as bytes, mostly as UTF-8."""
    how = draw(st.sampled_from(("utf-8",) * 20 + ("latin-1", "utf-16", "utf-8-sig")))
    return draw(text).encode(how, errors="replace")


def _place(sequence):
    return st.integers(0, len(sequence))


@st.composite
def _number_replaced(draw, text):
    found = list(_NUMBER.finditer(text))
    if not found:
        return text + draw(st.sampled_from(NUMBERS))
    one = draw(st.sampled_from(found))
    return text[: one.start()] + draw(st.sampled_from(NUMBERS)) + text[one.end() :]


@st.composite
def _word_replaced(draw, text):
    found = list(_WORD.finditer(text))
    new = draw(st.sampled_from((*WORDS, *NUMBERS)))
    if not found:
        return text + new
    one = draw(st.sampled_from(found))
    return text[: one.start()] + new + text[one.end() :]


@st.composite
def _words_exchanged(draw, text):
    found = list(_WORD.finditer(text))
    if len(found) < 2:
        return text
    a, b = sorted((draw(st.sampled_from(found)), draw(st.sampled_from(found))), key=lambda match: match.start())
    if a is b:
        return text
    return text[: a.start()] + b.group() + text[a.end() : b.start()] + a.group() + text[b.end() :]


@st.composite
def _misspelt(draw, text):
    found = [one for one in _WORD.finditer(text) if len(one.group()) > 3 and not one.group()[0].isdigit()]
    if not found:
        return text
    one = draw(st.sampled_from(found))
    at = draw(st.integers(one.start(), one.end() - 2))
    return text[:at] + text[at + 1] + text[at] + text[at + 2 :]


@st.composite
def _inserted(draw, text):
    at = draw(_place(text))
    return text[:at] + draw(st.sampled_from(WORDS)) + text[at:]


@st.composite
def _lost(draw, sequence):
    at = draw(_place(sequence))
    return sequence[:at] + sequence[at + draw(st.sampled_from(LOST)) :]


def _cut(sequence):
    return _place(sequence).map(lambda at: sequence[:at])


@st.composite
def _lines_changed(draw, text):
    lines = text.split("\n")
    a, b = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
    match draw(st.integers(0, 4)):
        case 0:
            del lines[a]
        case 1:
            lines.insert(a, lines[b])
        case 2:
            lines[a], lines[b] = lines[b], lines[a]
        case 3:
            lines[a:a] = [lines[b]] * 300
        case 4:
            lines.reverse()
    return "\n".join(lines)


def _separators_exchanged(text):
    return st.sampled_from(EXCHANGED).map(lambda pair: text.replace(*pair))


@st.composite
def _flipped(draw, data):
    changed = bytearray(data)
    for at in draw(st.lists(st.integers(0, max(len(data) - 1, 0)), max_size=16)) if data else ():
        changed[at] ^= 1 << draw(st.integers(0, 7))
    return bytes(changed)


@st.composite
def _length_changed(draw, data):
    """A length, count or offset that is as large as can be, or nothing."""
    width, at = draw(st.sampled_from((1, 2, 4, 8))), draw(_place(data))
    value = draw(st.sampled_from((0, 1, 255, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1))) & (2 ** (8 * width) - 1)
    return data[:at] + value.to_bytes(width, "little") + data[at + width :]


@st.composite
def _spliced(draw, data):
    a, b = sorted(draw(_place(data)) for _ in range(2))
    at = draw(_place(data))
    return data[:at] + data[a:b] + data[at:]


_OF_TEXT = (
    _number_replaced, _number_replaced, _number_replaced, _word_replaced, _word_replaced, _words_exchanged, _misspelt,
    _inserted, _inserted, _lost, _cut, _lines_changed, _separators_exchanged,
)  # fmt: skip
_OF_BYTES = (_flipped, _flipped, _length_changed, _spliced, _lost, _cut)
