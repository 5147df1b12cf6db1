"""Optics: spectral curves, point-spread functions, smear, and rendering onto pixels."""
