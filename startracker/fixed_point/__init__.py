"""The tracker in integer arithmetic: formats, tables, square roots, angles, attitude; its C sources are in ``c/``.

After Yee 1999, chapter 3.
"""
