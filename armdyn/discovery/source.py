"""Write candidate terms as a readable Python file of effects, and make effects of terms by loading such a file."""

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from textwrap import indent, wrap

import numpy as np

from armdyn import atomic
from armdyn.discovery.term import CandidateTerm, TermParameter
from armdyn.effects.effect import Effect
from armdyn.effects.user import effects_defined_in
from armdyn.user_code import load_module

FILE_HEAD_TEMPLATE = '''"""{title}"""

import casadi as ca

from armdyn import {names}
'''
EFFECT_TEMPLATE = '''

@effect(
    acts_on="{stage}",
    summary="{summary}.",
    source="armdyn discover",
)
def {name}(
    {stage},
{arguments}
):
    """{doc}"""
{body}
'''
INDENT, LINE_WIDTH = "    ", 110
MAX_SUMMANDS_PER_LINE = 3
"""Largest number of summands that are written in one line of code."""
SYMBOL_BY_UNIT = {"N": "F", "N m": "M", "m": "z"}
"""Symbol on the left side of a formula, by the unit of the term."""


def effects_of_terms(terms: Sequence[CandidateTerm]) -> tuple[Effect, ...]:
    """Make effects of candidate terms, in their order; the effect of a joint's term acts on that joint only."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "terms.py")
        atomic.write_text(path, effects_file_text("Candidate terms.", terms))
        found = effects_defined_in(path, vars(load_module(path, "terms")))
    return tuple(e.on(t.location.joint) if t.location.joint else e for e, t in zip(found, terms, strict=True))


def effects_file_text(title: str, terms: Iterable[CandidateTerm], evidence: Mapping[str, str] | None = None) -> str:
    """Text of a Python file that defines terms as effects.

    Args:
        title: first sentence of the file.
        terms: the terms; each becomes an effect.
        evidence: text of an effect's docstring after the formula, by the term's name.
    """
    terms = list(terms)
    reads = any(v.column for term in terms for v in term.variables)
    head = FILE_HEAD_TEMPLATE.format(title=title, names="column, effect, quantity" if reads else "effect, quantity")
    return head + "".join(_effect_text(term, (evidence or {}).get(term.name, "")) for term in terms)


def _effect_text(term: CandidateTerm, evidence: str) -> str:
    constants = {**dict.fromkeys(term.shapes, term.size_parameter), **term.parameters}
    arguments = [_argument(name, constant) for name, constant in constants.items()]
    columns = [(v.name, v.column) for v in term.variables if v.column is not None]
    arguments += [f'{name}=column("{c.name}", "{c.unit}", usual={_short(c.usual)})' for name, c in columns]
    reads = [f"{v.name} = {v.source}" for v in term.variables if v.column is None]
    doc = f"{SYMBOL_BY_UNIT.get(term.location.unit, 'y')} = {term.formula}."
    return EFFECT_TEMPLATE.format(
        stage=term.location.stage,
        summary=f"{term.description[:1].upper()}{term.description[1:]}",
        name=term.name,
        arguments=indent(",\n".join(arguments) + ",", INDENT),
        doc=doc + (f"\n\n{evidence}\n{INDENT}" if evidence else ""),
        body=indent("\n".join([*reads, *term.preceding_code, *_returned(term)]), INDENT),
    )


def _returned(term: CandidateTerm) -> list[str]:
    """Lines that return the changed stage; a sum of many terms gets a variable and a line for each."""
    if len(term.shapes) <= MAX_SUMMANDS_PER_LINE:
        return [f"return {term.location.code.format(term.force)}"]
    first, *others = term.summands
    total = ["total = (", f"    {first}", *(f"    + {other}" for other in others), ")"]
    return [*total, f"return {term.location.code.format('total')}"]


def _argument(name: str, of: TermParameter) -> str:
    """``name=quantity(...)``: a size has no spread, a constant starts at its value."""
    numbers = {"typical": of.typical or of.prior_std, "null": of.start_value, "lower": of.lower, "upper": of.upper}
    needed = {key: x for key, x in numbers.items() if abs(x) < np.inf and (x or key != "null")}
    needed |= {"spread": of.prior_std} if of.prior_std else {}
    parts = [f'"{of.unit}"', *(f"{key}={_short(x)}" for key, x in needed.items())]
    parts += [f'scope="{of.scope}"'] if of.scope != "shared" else []
    return f"{name}=quantity({', '.join(parts)})"


def _short(value: float) -> str:
    """A number as a person would write it, in Python's notation."""
    return repr(float(f"{value:.6g}"))


def indented_lines(text: str) -> str:
    """Break a docstring's text into indented lines."""
    return "\n".join(f"{INDENT}{line}" for part in text.split("\n") for line in (wrap(part, LINE_WIDTH) or [""]))
