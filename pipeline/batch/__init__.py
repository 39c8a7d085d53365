"""Batches: compare or repair a model with each of many recordings, and detect changes of its parameters over time."""
