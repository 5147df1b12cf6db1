"""Trials: one, and any number of them, on processes or a cluster, kept as they come."""
