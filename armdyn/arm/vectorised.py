"""Evaluate a symbolic function at all samples of a run, by one numpy operation per instruction."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from armdyn.errors import InputError
from armdyn.numpy_code import numpy_lines, unknown_operations


class OverTime:
    """Evaluates (m,) expressions of (15,) symbols of inputs, which change over time, and (k,) symbols of parameters.

    Raises:
        InputError: an expression contains an operation without a numpy counterpart.
    """

    def __init__(self, expressions: Any, inputs: Any, theta: Any) -> None:
        self._function = ca.Function("over_time", [inputs, theta], [ca.densify(expressions)])
        unknown = unknown_operations(self._function)
        if unknown:
            raise InputError(
                f"an effect uses CasADi operation {min(unknown)}, which cannot be evaluated over a run: write it with "
                "elementary functions"
            )

    @cached_property
    def _evaluate(self) -> Callable[[tuple[np.ndarray, np.ndarray], np.ndarray], None]:
        lines = numpy_lines(self._function, lambda i, j: f"given[{i}][{j}]", lambda _, j: f"result[{j}]")
        defined: dict[str, Any] = {"np": np}
        exec("\n    ".join(["def evaluate(given, result):", *lines, "return"]), defined)
        return defined["evaluate"]

    def __call__(self, inputs: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """(m, n) values for (15, n) inputs and (k,) parameters."""
        result = np.zeros((self._function.size1_out(0), inputs.shape[1]))
        with np.errstate(all="ignore"):  # a fit may try values without finite results
            self._evaluate((inputs, theta), result)
        return result
