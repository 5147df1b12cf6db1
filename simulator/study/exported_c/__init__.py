"""Compilation and measurement of the exported C; test centroid lists."""
