"""The protocol of spacenavd's socket, both versions, as a client speaks it; the server's side is in
the plug-in cardan-spnav-server."""
