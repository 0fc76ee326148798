"""What runs on a robot, as real files."""
