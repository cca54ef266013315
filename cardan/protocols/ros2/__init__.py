"""ROS 2 on the wire, without ROS: interfaces, CDR, type hashes, and rmw_zenoh's names."""
