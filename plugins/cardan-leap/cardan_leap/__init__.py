"""The Leap Motion Controller, for Cardan."""
