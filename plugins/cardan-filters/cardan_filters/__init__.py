"""Two published filters of shared control, and what reads a sensor's datagrams, for Cardan."""
