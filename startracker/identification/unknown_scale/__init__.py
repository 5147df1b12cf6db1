"""Identification without a known focal length: pairs of pairs of stars, and fits that leave the scale free."""
