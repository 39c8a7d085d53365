"""Names and sentences of others in files that we write: the one place where they become part of code.

A name keeps its letters where a reader looks for them, in a comment or in quotes, and can end neither. All else in a
generated file is numbers and identifiers made here. HTML is escaped by `html.escape`, XML by
`xml.etree`, whole TOML documents by tomlkit.
"""

import json
import re
from collections.abc import Iterable


def identifier(name: str) -> str:
    """A name as C, Python and CasADi take one: letters, digits and single underscores of ASCII, a letter first."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return plain if plain[:1].isalpha() else f"code_{plain}".rstrip("_")


def one_line(text: str) -> str:
    """The text in one line, with an escape for each character that does not show or turns the direction of reading."""
    return "".join(c if c.isprintable() else _escape(c) for c in text)


def c_comment(lines: Iterable[str]) -> str:
    """A comment of C of these lines, each in its own; nothing in them ends it or begins another."""
    # A trigraph is a backslash to old compilers; with a space it is none.
    safe = (re.sub(r"(?<=[*/?])(?=[*/?])", " ", one_line(line)) for line in lines)
    return "\n".join(("/*", *(f" * {line}".rstrip() for line in safe), " */"))


def python_docstring(lines: Iterable[str], indent: str = "") -> str:
    """A docstring of these lines, each in its own; nothing in them ends it or is an escape."""
    safe = [one_line(line).replace("\\", "\\\\").replace('"', '\\"') for line in lines]
    if len(safe) == 1:
        return f'{indent}"""{safe[0]}"""'
    return "\n".join((f'{indent}"""{safe[0]}', *(f"{indent}{line}".rstrip() for line in safe[1:]), f'{indent}"""'))


def toml_string(text: str) -> str:
    """A basic string of TOML, in quotes."""
    escapes = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "\r": "\\r"}
    return '"' + "".join(escapes.get(c, c if c.isprintable() else f"\\U{ord(c):08x}") for c in text) + '"'


def script_json(value: object) -> str:
    """JSON that neither ends the script element of HTML that it stands in nor a line of its script."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c").replace("\u2028", "\\u2028")


def _escape(character: str) -> str:
    code = ord(character)
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
