"""Study of the radiation environment: particles along the orbit, dose by shield, ageing with its range."""
