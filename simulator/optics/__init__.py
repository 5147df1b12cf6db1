"""Optics: curves over wavelength, point-spread functions, smear, and light onto pixels."""
