"""A solved image as an annotated picture."""
