"""Compilation and measurement of the exported C."""
