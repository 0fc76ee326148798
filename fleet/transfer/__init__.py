"""Which bytes are missing on a robot, and how they get there."""
