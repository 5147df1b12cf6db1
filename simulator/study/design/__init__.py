"""The smallest camera that will do."""
