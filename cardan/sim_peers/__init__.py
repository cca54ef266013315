"""One module per emulated device or controller, speaking the real protocol."""
