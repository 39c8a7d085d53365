"""Compile CasADi functions to machine code once and cache it; without a compiler CasADi's virtual machine is used."""

import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np

from armdyn import atomic
from armdyn.cache import is_private, private_directory
from armdyn.errors import InputError
from armdyn.quoting import identifier

# No -ffinite-math-only: a NaN must stay a NaN. No -march=native: the cache may be shared between machines. No
# reassociation and no contraction: an effect at its null value must change nothing to the last digit. -O2 takes twice
# the time to compile and gives code that is no faster.
COMPILER_FLAGS = ("-O1", "-fPIC", "-shared", "-w", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=off")
COMPILE_VARIABLE = "ARMDYN_COMPILE"
"""Environment variable; with ``0`` the virtual machine is used."""


@cache
def find_compiler() -> str | None:
    """The C compiler on the path; None where there is none or ``ARMDYN_COMPILE=0``."""
    if os.environ.get(COMPILE_VARIABLE) == "0":
        return None
    return shutil.which(os.environ.get("CC", "cc")) or shutil.which("gcc") or shutil.which("clang")


def compile_functions(name: str, functions: Mapping[str, ca.Function]) -> dict[str, ca.Function]:
    """Compile functions to machine code where a compiler exists; otherwise return them unchanged.

    The compiled library is stored in the user's private cache under a hash of its source and a hash of its content, so
    that the compiler runs once for the same equations, and again where the library was damaged. A failing compiler, a
    full disk or a cache that others can write to is not an error: CasADi's virtual machine gives the same numbers, more
    slowly.

    Args:
        name: first part of the library's file name.
        functions: functions by name; each keeps its inputs and outputs.
    """
    command = find_compiler()
    if command is None:
        return dict(functions)
    directory = private_directory()
    if directory is None:
        return dict(functions)
    name = identifier(name)[:48].rstrip("_")
    generator = ca.CodeGenerator(f"{name}.c", {"with_header": False})
    for key, function in functions.items():
        generator.add(function if function.name() == key else _renamed(key, function))
    source = generator.dump()
    identity = "\n".join((source, command, *COMPILER_FLAGS, platform.machine(), ca.__version__))
    stem = f"{name}-{hashlib.sha256(identity.encode()).hexdigest()[:20]}"
    try:
        library = _kept(directory, stem) or _compile(command, source, directory, stem)
        if library is not None:
            return {key: ca.external(key, str(library)) for key in functions}
    except (InputError, OSError, RuntimeError):  # a full disk, one without permission to execute, or a damaged library
        pass
    return dict(functions)


def _kept(directory: Path, stem: str) -> Path | None:
    """The library in the cache whose content matches the digest in its name; a damaged one is removed."""
    for library in sorted(directory.glob(f"{stem}-*.so")):
        if is_private(library) and library.name == _library_name(stem, library.read_bytes()):
            return library
        library.unlink(missing_ok=True)
    return None


def _library_name(stem: str, content: bytes) -> str:
    return f"{stem}-{hashlib.sha256(content).hexdigest()[:32]}.so"


def _renamed(key: str, function: ca.Function) -> ca.Function:
    inputs = [function.mx_in(i) for i in range(function.n_in())]
    return ca.Function(key, inputs, function.call(inputs), function.name_in(), function.name_out())


def _compile(command: str, source: str, directory: Path, stem: str) -> Path | None:
    """Compile the library; None where the compiler fails."""
    with tempfile.TemporaryDirectory(dir=directory) as scratch:
        code, product = Path(scratch, "code.c"), Path(scratch, "code.so")
        atomic.write_text(code, source)
        result = subprocess.run(
            [command, *COMPILER_FLAGS, str(code), "-o", str(product), "-lm"], capture_output=True, check=False
        )
        if result.returncode != 0:
            return None
        product.chmod(0o700)
        return product.replace(directory / _library_name(stem, product.read_bytes()))


class PreallocatedFunction:
    """A CasADi function with preallocated input and output arrays, so that a call has little overhead.

    Inputs and outputs must be dense; the arrays are (rows, columns), column-major. The next call overwrites the
    outputs: copy them where they are needed later.
    """

    def __init__(self, function: ca.Function) -> None:
        self.name = function.name()
        self._buffer, self._evaluate = function.buffer()
        inputs = [np.zeros(function.numel_in(i)) for i in range(function.n_in())]
        outputs = [np.zeros(function.numel_out(i)) for i in range(function.n_out())]
        for i, flat in enumerate(inputs):
            self._buffer.set_arg(i, flat.data)
        for i, flat in enumerate(outputs):
            self._buffer.set_res(i, flat.data)
        self.inputs = tuple(flat.reshape(function.size_in(i), order="F") for i, flat in enumerate(inputs))
        self.outputs = tuple(flat.reshape(function.size_out(i), order="F") for i, flat in enumerate(outputs))

    def __call__(self, *arguments: object) -> tuple[np.ndarray, ...]:
        """Evaluate the function for arrays or numbers in the order of its inputs, and return its output arrays."""
        for array, argument in zip(self.inputs, arguments, strict=True):
            given = np.asarray(argument, dtype=float)
            array[...] = given.reshape(array.shape, order="F") if given.shape != array.shape else given
        self._evaluate()
        return self.outputs
