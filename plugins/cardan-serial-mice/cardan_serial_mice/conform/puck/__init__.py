"""What the conformance of all serial six-axis devices shares."""
