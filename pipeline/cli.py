"""The program `armdyn`: handles signals such as Ctrl-C before slow imports begin, then runs the command."""

import os
import sys

from pipeline.interrupts import Interrupt, SignalHandler

ONE_THREAD_ENVIRONMENT = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "OMP_NUM_THREADS"), "1"
)
"""Environment variables that make libraries of linear algebra use one thread; see `armdyn.threads`."""


def main() -> None:
    """Run the command in `sys.argv`, and exit.

    Exit status: 0 done, 1 the answer is no or the task failed, 2 bad input, 3 an error of armdyn itself, 128 + n if
    signal n ended the command.
    """
    interrupts = SignalHandler()
    try:
        interrupts.install()
        os.environ.update(ONE_THREAD_ENVIRONMENT)
        from pipeline.console.app import run

        interrupts.check()
        status = run(interrupts)
        interrupts.finish()
    except BaseException as error:
        if interrupts.received is None:
            raise
        status = 128 + (error.number if isinstance(error, Interrupt) else interrupts.received)
        sys.stderr.write("armdyn: interrupted\n")
    sys.exit(status)


if __name__ == "__main__":
    main()
