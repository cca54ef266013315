"""What serial six-axis devices are judged by."""
