"""The model at work beside the arm: what touches it, what it carries, what of it changed."""
