"""The console: a page that shows the arms, moves them, and lets a phone be the operator device."""
