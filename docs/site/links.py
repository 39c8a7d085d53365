"""Makes links from the documentation to the source work on the site: they lead to the repository."""

import re
from typing import Any

OUTSIDE = re.compile(r"\]\(\.\./([^)]+)\)")


def on_page_markdown(markdown: str, config: Any, **_: Any) -> str:
    """Links that leave ``docs/`` become links to the repository, or plain text where the site knows of none."""
    base = config.repo_url
    text = re.compile(r"\[([^\]]*)\]\(\.\./[^)]+\)")
    return OUTSIDE.sub(rf"]({base.rstrip('/')}/blob/main/\1)", markdown) if base else text.sub(r"\1", markdown)
