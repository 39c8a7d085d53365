"""The residual of a fit: tests against noise, where it is large, and the force that would explain it."""
