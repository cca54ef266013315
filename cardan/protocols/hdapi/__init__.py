"""HDAPI, the C interface of the OpenHaptics library libHD: its names and values."""
