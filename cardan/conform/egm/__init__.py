"""Conformance of Externally Guided Motion: of the controller, and of the driver on the PC."""
