"""How fast: each stage and whole trials against size and number of stars, peers beside them, and the targets."""
