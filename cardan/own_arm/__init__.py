"""Creation of an arm's file from a vendor's URDF, with trials and pictures of the arm."""
