"""Which effects are missing: scores of sets, the search for the best one, and what of it is reported."""
