"""Error budgets: the contribution of each effect."""
