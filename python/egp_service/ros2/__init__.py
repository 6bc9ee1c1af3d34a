"""ROS 2 without ROS: a node that speaks the protocol of rmw_zenoh (docs/ros2.md)."""
