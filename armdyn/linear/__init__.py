"""Linear algebra shared by fits, evidence and the design of experiments."""
