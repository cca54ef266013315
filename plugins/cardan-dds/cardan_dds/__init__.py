"""The network over DDS: topics and services of ROS 2 nodes with rmw_cyclonedds and others."""
