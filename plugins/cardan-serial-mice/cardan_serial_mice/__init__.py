"""Six-axis devices at a serial port, for Cardan: Magellan, Spaceball and SpaceOrb."""
