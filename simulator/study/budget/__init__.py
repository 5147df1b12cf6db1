"""Error budgets: what each effect adds."""
