"""Linear algebra has one thread while armdyn computes.

Its matrices have tens or hundreds of rows. Threads that share such a product wait for each other longer than they
compute: a repair of a real arm takes three to four times the processor time with two of them. And they add in another
order, so that the last digits of an answer would depend on how many they are.
"""

from contextlib import ContextDecorator

import scipy.linalg  # noqa: F401  has a library of its own beside numpy's, which is limited only once it is loaded
from threadpoolctl import threadpool_limits

one_thread: ContextDecorator = threadpool_limits.wrap(limits=1, user_api="blas")
"""Decorates a function: linear algebra has one thread until it returns, and then as many as the caller gave it.

The number is one of the whole process: what other Python threads compute meanwhile has one thread as well.
"""


def keep_one_thread() -> None:
    """Leave linear algebra one thread for good, in a process that computes for nobody else."""
    threadpool_limits(limits=1, user_api="blas")
