"""Recordings: channels and their units, the formats they are read from, and what is cleaned before a fit."""
