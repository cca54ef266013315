"""ROS 2's wire formats without ROS: interfaces, CDR, type hashes, and rmw_zenoh's names."""
