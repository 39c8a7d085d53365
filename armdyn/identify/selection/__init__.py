"""Choose the missing effects: scores of sets, the search for the best set, and the effects that are reported."""
