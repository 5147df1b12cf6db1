"""Two theses recomputed, with printed and computed values side by side."""
