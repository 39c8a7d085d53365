"""Errors come whole out of a worker process: one that cannot be made again ends the whole pool."""

import pickle

import pytest

from armdyn.channels import SampleError
from armdyn.errors import InputError, UnknownNameError
from ik.errors import UnreachableError


@pytest.mark.parametrize(
    "error",
    [
        InputError("a sentence"),
        UnknownNameError("effect", "linear_drog", ["linear_drag", "quadratic_drag"]),
        SampleError(3, "1e+09 rad is beyond 10000 rad"),
        UnreachableError("no way"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_an_error_comes_whole_out_of_another_process(error):
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)
