"""Missions that run live: stepped by a clock, or by another simulator."""
