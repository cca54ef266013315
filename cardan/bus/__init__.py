"""The bus of sessions, servers, drivers and simulated peers: Zenoh, with ROS 2's names."""
