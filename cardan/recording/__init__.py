"""Records what is on the bus as MCAP files, plays them back, and holds the control core against
them."""
