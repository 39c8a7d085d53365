"""A symbolic function at all samples of a run: one numpy operation per instruction instead of one call per sample."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from armdyn.errors import InputError
from armdyn.numpy_code import numpy_lines, unknown_operations


class OverTime:
    """Evaluates expressions of inputs that change over time and of parameters that do not.

    Args:
        expressions: (m,).
        inputs: (15,) symbols.
        theta: (k,) symbols.

    Raises:
        InputError: an expression holds an operation without a numpy counterpart.
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
        """From inputs and parameters into the rows of a result."""
        lines = numpy_lines(self._function, lambda i, j: f"given[{i}][{j}]", lambda _, j: f"result[{j}]")
        defined: dict[str, Any] = {"np": np}
        exec("\n    ".join(["def evaluate(given, result):", *lines, "return"]), defined)
        return defined["evaluate"]

    def __call__(self, inputs: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """(m, n) for (15, n) inputs and (k,) parameters."""
        result = np.zeros((self._function.size1_out(0), inputs.shape[1]))
        with np.errstate(all="ignore"):  # a fit tries values where nothing is finite, and sees it in the result
            self._evaluate((inputs, theta), result)
        return result
