"""The catalogue of physical effects: one small definition each, in a file per place where it acts."""
