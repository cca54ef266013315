"""Examples that run without hardware: their simulated peers, and a session."""
