"""Many robots, many days: compare or repair for every recording that a SPEC names, and what changed when."""
