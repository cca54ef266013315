"""What every layer stands on: options, tables, sockets, signals, text for terminals, extras."""
