"""Conversion of bytes to values and back. No sockets, no threads, no clocks, no files."""
