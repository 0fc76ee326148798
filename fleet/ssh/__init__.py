"""How a command or a stream of bytes reaches a robot."""
