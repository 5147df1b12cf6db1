"""The tracker in integers: formats, tables, roots, angles, attitude, and their export to C (Yee 1999, chapter 3)."""
