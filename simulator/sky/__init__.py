"""The sky from the spacecraft: where stars and planets appear, and how much light they send."""
