"""A progress bar on standard error, for work that has phases."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def phase_progress() -> Iterator[Callable[[str, float], None]]:
    """Show what is going on and how much of it is done, until the block ends.

    Yields:
        ``show(what, share)``, the share from 0 to 1.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<24}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=1.0)

        def show(what: str, share: float) -> None:
            bar.update(task, description=what, completed=share)

        yield show
