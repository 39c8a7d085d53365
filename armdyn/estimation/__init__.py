"""The kernel of every statistic: sums over samples, priors, posteriors and their solution. It knows arrays alone."""
