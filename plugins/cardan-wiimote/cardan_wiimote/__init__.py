"""Nintendo's Wii Remotes, for Cardan."""
