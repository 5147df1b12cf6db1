"""Integer arithmetic of the thesis (Yee 1999, chapter 3): formats, tables, square roots, angles, centroids.

`FixedArithmetic` has the formats of the thesis, `WideArithmetic` those that it recommends; with both, the pipeline of
triads (`startracker.identification.triad_votes`) runs without floating point. What flies is `startracker.flight`.
"""
