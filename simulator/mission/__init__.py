"""Time, position and attitude of the spacecraft: clock, orbit, pointing."""
