"""What a card needs for the first boot of a robot, and how it gets there."""
