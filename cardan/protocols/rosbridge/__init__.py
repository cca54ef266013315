"""Server side of rosbridge v2: ROS over WebSocket as JSON and CBOR."""
