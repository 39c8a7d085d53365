"""Formulas for a missing force that no effect of the catalogue explains, written as a file of effects."""
