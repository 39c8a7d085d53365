"""Reports: one offline HTML file with a verdict, key figures and a section per question."""

from armdyn.document import Chart, Document, KeyFigure, Level, Section, Table

__all__ = ["Chart", "Document", "KeyFigure", "Level", "Section", "Table"]
