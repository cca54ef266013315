"""Common parts of the suites for all serial six-axis devices."""
