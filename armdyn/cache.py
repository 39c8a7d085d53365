"""Where things that are slow to make are kept between calls."""

import os
from pathlib import Path


def cache_directory() -> Path:
    """Directory for generated code and tables, created if absent.

    ``$ARMDYN_CACHE`` if set, else ``$XDG_CACHE_HOME/armdyn``, else ``~/.cache/armdyn``.
    """
    root = os.environ.get("ARMDYN_CACHE")
    directory = Path(root) if root else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "armdyn"
    directory.mkdir(parents=True, exist_ok=True)
    return directory
