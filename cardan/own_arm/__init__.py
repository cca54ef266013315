"""An arm's file made of a vendor's URDF, and what is tried and drawn of the arm."""
