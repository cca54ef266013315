"""Recording of the bus as MCAP files, replay, and verification of the controller by records."""
