"""Specifications and the verdicts on them: what is required, what was measured or predicted, and whether it is met."""
