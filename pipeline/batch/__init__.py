"""Batches: compare or repair for every recording that a SPEC names, and detect changes over time."""
