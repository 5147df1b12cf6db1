"""The tracker in integer arithmetic: formats, tables, square roots, angles, attitude, and the export to C.

After Yee 1999, chapter 3.
"""
