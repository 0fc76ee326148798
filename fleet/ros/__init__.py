"""The ROS environment of a robot, and how to listen to its topics."""
