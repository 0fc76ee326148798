"""What the talker says, apart from how ROS carries it."""
