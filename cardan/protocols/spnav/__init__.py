"""Protocol of spacenavd's socket, client side, both versions; the server side is in the plug-in
cardan-spnav-server."""
