"""Basis of every layer: options, tables, sockets, signals, text for terminals, extras."""
