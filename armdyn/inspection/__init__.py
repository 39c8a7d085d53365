"""Are recordings what they say they are? Checks of the signals alone, and hypotheses tested by a model's physics."""
