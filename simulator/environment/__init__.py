"""Radiation of an orbit and its effects on a camera: particles at each position, dose and displacement damage behind a
shield, and the resulting ageing of detector and glass.

Data flow: position → flux (`trapped`, `galactic`, `solar`) → behind the shield (`shield`, with the tables of `matter`)
→ particles of a frame (`transients`), or averaged over the orbit (`dose`) → damage (`damage`). The coefficients with
their sources and ranges are in `coefficients`.
"""
