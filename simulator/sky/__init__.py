"""The sky from the spacecraft: apparent positions and brightness of stars and bodies."""
