"""rosbridge v2, the server's side: ROS over WebSocket as JSON and CBOR."""
