"""The smallest sufficient camera."""
