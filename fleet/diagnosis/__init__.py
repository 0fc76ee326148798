"""The meaning of tools' error output, and the cures."""
