"""Trials: single ones, and runs in processes or on a cluster, stored as they finish."""
