"""Monte Carlo studies: trials, their statistics, their report."""
