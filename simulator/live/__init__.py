"""Cameras in the loop: the mission in real time, and the stimulator before a real star tracker."""
