"""A plotly figure that is still visible when a saved notebook is converted to a page."""

from typing import Any

import plotly.graph_objects as go


class OfflineFigure(go.Figure):  # type: ignore[misc]
    """A plotly figure that a notebook also stores as HTML and text, because `nbconvert` cannot draw plotly's form."""

    def _repr_mimebundle_(self, *_: Any, **__: Any) -> dict[str, Any]:
        return {
            "application/vnd.plotly.v1+json": self.to_plotly_json(),
            "text/html": self.to_html(full_html=False, include_plotlyjs="cdn"),
            "text/plain": f"figure: {', '.join(dict.fromkeys(str(trace.name) for trace in self.data))}",
        }

    def _ipython_display_(self) -> None:
        from IPython.display import display

        display(self._repr_mimebundle_(), raw=True)
