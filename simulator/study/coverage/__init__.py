"""Stars in the field over the sky or along the path."""
