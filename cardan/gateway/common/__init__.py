"""What the rooms of the gateway share: kinds of configuration values, Unix sockets that serve."""
