"""The console: a page that shows the arms, moves them, and serves a phone as the operator
device."""
