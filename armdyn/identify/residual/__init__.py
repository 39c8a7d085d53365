"""What a fit leaves unexplained: tests of it, where it is, and the force that would explain it."""
