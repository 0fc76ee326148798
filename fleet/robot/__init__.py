"""What a robot has, and what it should have."""
