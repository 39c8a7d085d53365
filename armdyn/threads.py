"""Linear algebra uses one thread while armdyn computes.

Its matrices have tens or hundreds of rows. Threads that share such a product wait for each other longer than they
compute: with two threads, a repair of a real arm takes three to four times the processor time. They also sum in another
order, so the last digits of an answer would depend on the number of threads.
"""

from contextlib import ContextDecorator

import scipy.linalg  # noqa: F401  has a library of its own beside numpy's, which is limited only once it is loaded
from threadpoolctl import threadpool_limits

one_thread: ContextDecorator = threadpool_limits.wrap(limits=1, user_api="blas")
"""Decorator: linear algebra uses one thread until the function returns, then as many as before.

The number holds for the whole process: other Python threads also compute with one thread meanwhile.
"""


def keep_one_thread() -> None:
    """Set linear algebra to one thread permanently, in a process that computes for nobody else."""
    threadpool_limits(limits=1, user_api="blas")
