"""One module per real device or controller: opens it, speaks its protocol, nothing else."""
