"""What must be fast: measured beside the usual tools, pair by pair. `make bench` runs it."""
