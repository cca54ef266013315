"""The Phantom Omni, Geomagic Touch and 3D Systems Touch, for Cardan."""
