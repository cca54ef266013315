"""Activities of an arm, one at a time. No activity supervises or limits."""
