"""Reports: one offline HTML file with a verdict, key figures and a section per question."""

from pipeline.report.page import Chart, KeyFigure, Level, Report, Section, Table

__all__ = ["Chart", "KeyFigure", "Level", "Report", "Section", "Table"]
