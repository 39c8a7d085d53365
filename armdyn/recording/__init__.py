"""Recordings: channels and their units, file formats, and the cleaning of samples before a fit."""
