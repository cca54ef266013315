"""Records of the bus as MCAP files, their replay, and verification of the control core by them."""
