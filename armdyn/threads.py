"""Limit linear algebra to one thread while armdyn computes.

Its matrices have tens or hundreds of rows. Threads that share such a product wait for each other longer than they
compute: with two threads, a repair of a real arm takes three to four times the processor time. They also sum in another
order, so the last digits of an answer would depend on the number of threads.
"""

from contextlib import ContextDecorator

import scipy.linalg  # noqa: F401  has a library of its own beside numpy's, which is limited only once it is loaded
from threadpoolctl import threadpool_limits

one_thread: ContextDecorator = threadpool_limits.wrap(limits=1, user_api="blas")
"""Decorator: linear algebra uses one thread until the function returns, then as many as before.

The limit holds for the whole process, so other Python threads also compute with one thread in the meantime.
"""


def use_one_thread_permanently() -> None:
    """Limit linear algebra to one thread for the rest of the process; for processes that belong to armdyn alone."""
    threadpool_limits(limits=1, user_api="blas")
