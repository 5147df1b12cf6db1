"""Identification without a known focal length: scale-free patterns of four stars, and fits that leave the scale
free."""
