"""Emulated devices and controllers that speak the real protocol, a module for each."""
