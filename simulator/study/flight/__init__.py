"""The flight build of a scenario: its design, and its comparison with the star tracker."""
