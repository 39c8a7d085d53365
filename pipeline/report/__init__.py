"""Reports: one offline HTML file with a verdict, key figures and a section per question."""

from pipeline.report.page import KeyFigure, Level, Report
from pipeline.report.section import Chart, Section, Table

__all__ = ["Chart", "KeyFigure", "Level", "Report", "Section", "Table"]
