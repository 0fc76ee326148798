"""What a tool's output means, and what cures the fault."""
