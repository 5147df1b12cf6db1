"""Planted faults: the share of small changes to the code that its tests notice."""
