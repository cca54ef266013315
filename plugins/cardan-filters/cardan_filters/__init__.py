"""Two published filters of shared control, and the reader of a sensor's datagrams, for Cardan."""
