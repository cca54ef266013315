"""What an arm can be doing, one at a time. No activity supervises or limits."""
