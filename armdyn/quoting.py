"""Quote names and texts from input files in generated files, so that they cannot become code.

A text in a comment or in quotes stays readable, and cannot end the comment or the quotes. HTML is escaped by
`html.escape`, XML by `xml.etree`, and whole TOML documents by tomlkit instead.
"""

import json
import re
import shlex
from collections.abc import Iterable


def identifier(name: str) -> str:
    """Turn a name into an identifier of C, Python and CasADi: ASCII letters, digits, single underscores."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return plain if plain[:1].isalpha() else f"code_{plain}".rstrip("_")


def one_line(text: str) -> str:
    """The text in one line, with escapes for invisible characters and for those that change the reading direction."""
    return "".join(c if c.isprintable() else _escape(c) for c in text)


def c_comment(lines: Iterable[str]) -> str:
    """Write lines of text as a C comment; the text can neither end the comment nor begin another one."""
    # A trigraph is a backslash to old compilers; with a space it is none.
    safe = (re.sub(r"(?<=[*/?])(?=[*/?])", " ", one_line(line)) for line in lines)
    return "\n".join(("/*", *(f" * {line}".rstrip() for line in safe), " */"))


def python_docstring(lines: Iterable[str], indent: str = "") -> str:
    """Write lines of text as a Python docstring; the text can neither end the docstring nor act as an escape."""
    safe = [one_line(line).replace("\\", "\\\\").replace('"', '\\"') for line in lines]
    if len(safe) == 1:
        return f'{indent}"""{safe[0]}"""'
    return "\n".join((f'{indent}"""{safe[0]}', *(f"{indent}{line}".rstrip() for line in safe[1:]), f'{indent}"""'))


def toml_string(text: str) -> str:
    """Write a text as a basic TOML string, in quotes."""
    escapes = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "\r": "\\r"}
    return '"' + "".join(escapes.get(c, c if c.isprintable() else f"\\U{ord(c):08x}") for c in text) + '"'


def script_json(value: object) -> str:
    """Write a value as JSON that can end neither an HTML script element nor a line of the script."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c").replace("\u2028", "\\u2028")


def _escape(character: str) -> str:
    code = ord(character)
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def name_list(names: Iterable[str], most: int = 4) -> str:
    """List names for a sentence, separated by commas: the first `most` of them and the number of the others."""
    names = list(names)
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def shell_quoted_command(*words: object) -> str:
    """Text of an armdyn command, quoted for a shell, from its words after ``armdyn``."""
    return shlex.join(["armdyn", *map(str, words)])
