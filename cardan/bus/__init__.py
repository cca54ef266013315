"""The bus that sessions, faces, drivers and simulated peers meet on: Zenoh, with ROS 2's names."""
