"""What arms on ROS 2 and on the joint stream are judged by, and a driver of the latter."""
