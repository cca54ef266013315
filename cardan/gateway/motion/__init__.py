"""Motion in time: profiles along a length, paths of poses and joints, shaping tick by tick."""
